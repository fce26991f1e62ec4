"""The navigator flies with the smallest and the largest number of each key that the configuration lets through."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from benchmarks.flown import navigator_flight
from visloc_companion.app.settings import core_settings
from visloc_companion.config import GnssConfig, InjectionConfig, LocaliserConfig, NavigatorConfig, parse_config
from visloc_companion.config_section import LEAST, MOST, Section
from visloc_companion.core.navigator import Navigator
from visloc_companion.types import Status

SECTIONS: dict[str, type[Section]] = {
    "navigator": NavigatorConfig,
    "gnss": GnssConfig,
    "injection": InjectionConfig,
    "localiser": LocaliserConfig,
}
JAMMED_S, UNTIL_S = 9.0, 8.0


def ends() -> Iterator[tuple[str, str, float]]:
    """Of all numbers that are not bounded on both sides."""
    for section, model in SECTIONS.items():
        for key, field in model.model_fields.items():
            bounds = {
                name: value
                for item in field.metadata
                for name in ("gt", "ge", "lt", "le")
                if (value := getattr(item, name, None)) is not None
            }
            if field.annotation is float and list(bounds) in (["gt"], ["ge"]):
                yield section, key, bounds.get("ge", LEAST)
                yield section, key, MOST


@pytest.mark.parametrize(("section", "key", "value"), list(ends()))
def test_the_ends_of_what_is_allowed_can_be_computed_with(
    section: str, key: str, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(navigator_flight, "JAMMED_S", JAMMED_S)
    navigator = Navigator(core_settings(parse_config({section: {key: value}})))
    worker, statuses = navigator_flight.Answers(), []
    for t_ns, event in navigator_flight.events(UNTIL_S):
        for at_ns, answer in [*worker.until(t_ns), (t_ns, event)]:
            commands = navigator.on(answer, max(t_ns, at_ns))
            worker.ask(t_ns, commands)
            statuses += [command for command in commands if isinstance(command, Status)]
    levels = [status.protection_level_m for status in statuses if status.protection_level_m is not None]
    assert len(statuses) > 70
    assert all(map(math.isfinite, levels))
