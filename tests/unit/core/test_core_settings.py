from __future__ import annotations

import dataclasses

import pytest

from visloc_companion import config
from visloc_companion.core import settings

LINKS_OWN = {"output", "position_sensor_id", "external_estimate_period_s", "max_outside_map_m", "set_origin"}
"""Keys of `injection` that concern how positions are written and fenced, which the core does not know."""


@pytest.mark.parametrize(
    ("ours", "theirs", "elsewhere"),
    [
        (settings.NavigatorSettings(), config.NavigatorConfig(), set()),
        (settings.GnssSettings(), config.GnssConfig(), set()),
        (settings.InjectionSettings(), config.InjectionConfig(), LINKS_OWN),
    ],
)
def test_names_and_defaults_are_those_of_the_configuration(ours: object, theirs: config.Section, elsewhere: set[str]) -> None:
    known = {name: value for name, value in theirs.model_dump().items() if name not in elsewhere}
    assert dataclasses.asdict(ours) == known  # type: ignore[call-overload]
