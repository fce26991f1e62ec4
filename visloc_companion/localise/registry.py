"""Configuration names to localisers."""

from __future__ import annotations

from visloc_companion.errors import ConfigError
from visloc_companion.localise.dense import GradientLocaliser
from visloc_companion.localise.keypoint import KeypointLocaliser
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.template import NccLocaliser
from visloc_companion.protocols import Localiser
from visloc_companion.types import CameraModel

LOCALISERS: dict[str, type[GradientLocaliser] | type[NccLocaliser] | type[KeypointLocaliser]] = {
    "gradient": GradientLocaliser,
    "ncc": NccLocaliser,
    "keypoint": KeypointLocaliser,
}
METHODS: tuple[str, ...] = tuple(LOCALISERS)


def make_localiser(
    method: str,
    model: CameraModel,
    *,
    map_sigma_m: float = 0.0,
    max_probability_wrong: float = 0.05,
    max_search_radius_m: float = 2000.0,
) -> Localiser:
    """The localiser of a name. Raises ConfigError for a name that this version does not have."""
    if method not in LOCALISERS:
        raise ConfigError(f"unknown method {method!r}", where="localiser.method", remedy=f"use one of {', '.join(METHODS)}")
    return LOCALISERS[method](
        model,
        LocaliserSettings(
            max_probability_wrong=max_probability_wrong, max_search_radius_m=max_search_radius_m, map_sigma_m=map_sigma_m
        ),
    )
