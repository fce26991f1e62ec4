"""What the filter goes through again for a late answer, it goes through once."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from visloc_companion.core.filter import fusion
from visloc_companion.types import Command, Event, Fix, Odometry


def test_an_answer_with_motion_and_fix_folds_what_came_after_it_once(world: type[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    flight = world()
    on, propagated = flight.navigator.on, fusion.propagated
    steps: Counter[tuple[int, int]] = Counter()
    last_ns, most, n_motions = 0, 0, 0

    def counted(belief: Any, t_ns: int, *args: Any, alone: bool = False) -> Any:
        steps[belief.t_ns, t_ns] += not alone
        return propagated(belief, t_ns, *args, alone=alone)

    def with_motion(event: Event, now_ns: int) -> list[Command]:
        nonlocal last_ns, most, n_motions
        if isinstance(event, Fix):
            dt_s, (north, east) = (event.t_ns - last_ns) * 1e-9, flight.velocity(event.t_ns * 1e-9)
            moved = (north * dt_s, east * dt_s, 0.0)
            cov = ((0.02, 0.0), (0.0, 0.02))
            motion = Odometry(event.t_ns, last_ns, event.t_ns, moved, cov, 0.01, 0.01, 0.9, "flow") if last_ns else None
            event, last_ns, n_motions = replace(event, motion=motion), event.t_ns, n_motions + (motion is not None)
        steps.clear()
        commands: list[Command] = on(event, now_ns)
        if isinstance(event, Fix):
            most = max(most, *steps.values(), 0)
        return commands

    monkeypatch.setattr(fusion, "propagated", counted)
    monkeypatch.setattr(flight.navigator, "on", with_motion)
    flight.start()
    flight.fly(40.0)
    assert n_motions > 20
    assert most == 1
