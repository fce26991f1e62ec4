from __future__ import annotations

import dataclasses

import pytest

from visloc_companion import config
from visloc_companion.core import settings


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (settings.NavigatorSettings(), config.NavigatorConfig()),
        (settings.GnssSettings(), config.GnssConfig()),
        (settings.InjectionSettings(), config.InjectionConfig()),
    ],
)
def test_names_and_defaults_are_those_of_the_configuration(ours: object, theirs: config.Section) -> None:
    assert dataclasses.asdict(ours) == theirs.model_dump()  # type: ignore[call-overload]
