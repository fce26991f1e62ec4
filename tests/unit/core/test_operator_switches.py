"""The daemon may not switch the autopilot's source; its operator does as he is asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from visloc_companion.core.settings import CoreSettings
from visloc_companion.types import Command, EkfSource, EstimatorStatus, Event, Notice

AFTER_S, FALSE_S = 2.0, (30.0, 60.0)


@pytest.fixture
def operated(world: Any) -> type[Any]:
    """Now and then the autopilot rejects a position of the source that it is on from `rejects` on."""

    @dataclass
    class Operated(world):  # type: ignore[misc]
        rejects: EkfSource = EkfSource.VISION
        orders: tuple[float, EkfSource] | None = None

        def send(self, event: Event) -> list[Command]:
            if isinstance(event, EstimatorStatus) and self.source is self.rejects and self.k % 50 == 0:
                event = replace(event, position_ratio=1.2)
            commands: list[Command] = super().send(event)
            for command in commands:
                if isinstance(command, Notice) and "set EKF position source to" in command.text:
                    source = EkfSource.VISION if "VISION" in command.text else EkfSource.GNSS
                    self.orders = self.t + AFTER_S, source
            return commands

        def step(self) -> None:
            super().step()
            if self.orders is not None and self.t >= self.orders[0]:
                self.source, self.orders = self.orders[1], None

    return Operated


def test_positions_that_it_rejects_on_vision_do_not_speak_against_gnss(operated: Any) -> None:
    w = operated(settings=CoreSettings(), pull_m=lambda t: (60.0 * (FALSE_S[0] < t < FALSE_S[1]), 0.0))
    w.start()
    w.fly(130.0)
    (vision_s,), (gnss_s,) = w.notices("position source to VISION"), w.notices("position source to GNSS")
    assert FALSE_S[0] < vision_s < FALSE_S[0] + 6
    assert FALSE_S[1] + w.settings.gnss.probation_s < gnss_s < FALSE_S[1] + 45
    assert w.source is EkfSource.GNSS
    assert w.status_at(129.0)[0].verdict.value == "ok"


def test_those_of_gnss_do(operated: Any) -> None:
    w = operated(settings=CoreSettings(), rejects=EkfSource.GNSS, jammed=lambda t: 10 < t < 20)
    w.blind = lambda t: True
    w.start()
    w.fly(60.0)
    assert w.source is EkfSource.GNSS, "without a fix nobody was asked to leave it"
    assert w.status_at(59.0)[0].verdict.value == "suspect"
