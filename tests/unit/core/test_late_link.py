"""The autopilot is still on vision, on its way back to GNSS, when its messages become late: the offset of the clocks steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import pytest

from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.core.source.switching import HAND_BACK_NS
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Command,
    EkfSource,
    Event,
    Gnss,
    Injection,
    LinkChanged,
    PriorPose,
    SwitchSource,
)

JAMMED_S, LATE_S = (30.0, 60.0), 9.0


@pytest.fixture
def on_vision(world: Any) -> type[Any]:
    """From `late_from` on all messages are late by `by_s`, or bear a clock that is behind by that."""

    @dataclass
    class OnVision(world):  # type: ignore[misc]
        by_s: float = 0.8
        late_from: float = float("inf")

        def send(self, event: Event) -> list[Command]:
            if isinstance(event, Attitude | PriorPose | Gnss) and self.late_from < self.t < self.late_from + LATE_S:
                event = replace(event, t_boot_ns=event.t_boot_ns - round(self.by_s * 1e9))
            commands: list[Command] = super().send(event)
            return commands

        @property
        def back(self) -> list[float]:
            """When the autopilot, or its operator, was asked to go back to GNSS."""
            ordered = [t for t, c in self.commands if isinstance(c, SwitchSource) and c.source is EkfSource.GNSS]
            return [t for t in (*ordered, *self.notices("position source to GNSS")) if t > JAMMED_S[1]]

    return OnVision


def flown_back(w: Any, until_late_s: float) -> float:
    """Jammed, on vision, asked to go back, which nobody does, and late; when that was asked."""
    w.start()
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(JAMMED_S[1] + 2.0)
    w.source = EkfSource.VISION
    while not w.back:
        w.step()
    asked_s: float = w.back[0]
    w.late_from = asked_s + until_late_s
    w.fly(asked_s + HAND_BACK_NS * 1e-9 + 10.0)
    return asked_s


@pytest.mark.parametrize("switches", [True, False])
def test_a_link_that_becomes_late_ends_no_positions_on_the_way_back_to_gnss(on_vision: type[Any], switches: bool) -> None:
    settings = CoreSettings(injection=InjectionSettings(switch_source=switches))
    w = on_vision(settings=settings, jammed=lambda t: JAMMED_S[0] < t < JAMMED_S[1], deaf=lambda t: t > JAMMED_S[1])
    asked_s = flown_back(w, until_late_s=5.0)
    assert len(w.notices("clocks stepped apart by 0.8 s")) == 1
    sent = [t for t, c in w.commands if isinstance(c, Injection) and t > asked_s]
    assert sent[-1] - asked_s == pytest.approx(HAND_BACK_NS * 1e-9 + 10.0 * switches, abs=1.0)
    assert max(after - before for before, after in pairwise(sent)) < 0.5


def test_an_autopilot_whose_clock_began_anew_is_on_what_its_parameters_say(on_vision: type[Any]) -> None:
    w = on_vision(by_s=900.0, settings=CoreSettings(), jammed=lambda t: JAMMED_S[0] < t < JAMMED_S[1])
    asked_s = flown_back(w, until_late_s=5.0)
    assert w.notices("autopilot clock stepped")
    assert [t for t, c in w.commands if isinstance(c, Injection)][-1] - asked_s == pytest.approx(5.0, abs=0.5)
