"""Configuration names to localisers."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.errors import ConfigError
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.localise.around.rectified import behind_the_lens
from visloc_companion.localise.cross_view import CrossViewLocaliser
from visloc_companion.localise.dense import deep_localiser, gradient_localiser
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.onnx import NetworkFeatures, open_features
from visloc_companion.localise.iclk import IclkLocaliser
from visloc_companion.localise.keypoint import KeypointLocaliser
from visloc_companion.localise.mapped.map_light import MapLight
from visloc_companion.localise.mutual_information import MutualInformationLocaliser
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.localise.settings import MOST_POSITIONS, LocaliserSettings, Looks
from visloc_companion.localise.template import NccLocaliser
from visloc_companion.protocols import Localiser
from visloc_companion.types import CameraModel

ON_FEATURES: dict[str, Callable[[CameraModel, LocaliserSettings, Features], Localiser]] = {
    "deep": deep_localiser,
    "cross-view": CrossViewLocaliser,
    "iclk": IclkLocaliser,
}
"""Those that look through dense features that somebody else opens: a network's."""
ON_PIXELS: dict[str, Callable[[CameraModel, LocaliserSettings], Localiser]] = {
    "gradient": gradient_localiser,
    "ncc": NccLocaliser,
    "keypoint": KeypointLocaliser,
    "mi": MutualInformationLocaliser,
}
"""Those that need nothing but frame and map."""
METHODS: tuple[str, ...] = (*ON_FEATURES, *ON_PIXELS)


def needs_features(method: str) -> bool:
    """Whether `make_localiser` must be given features for this method."""
    return method in ON_FEATURES


def open_features_for(method: str, network: NetworkChoice) -> NetworkFeatures | None:
    """Open and test the network where the method needs its features; None where it does not.

    Raises ConfigError or ModelError as `open_features` does.
    """
    if not needs_features(method):
        return None
    return open_features(network.folder, network.providers, network.threads, network.variant)


def make_localiser(
    method: str,
    model: CameraModel,
    *,
    features: Features | None = None,
    map_sigma_m: float = 0.0,
    max_probability_wrong: float = 0.05,
    max_search_radius_m: float = 2000.0,
    most_positions: int = MOST_POSITIONS,
    threads: int = 1,
    looks: Looks = Looks.BOTH,
    light: MapLight | None = None,
) -> Localiser:
    """The localiser of a name; `features` and `light` are ignored by those that need none.

    Raises ConfigError for a name that this version does not have, or where features are needed and none are given.
    """
    settings = LocaliserSettings(
        max_probability_wrong=max_probability_wrong,
        max_search_radius_m=max_search_radius_m,
        most_positions=most_positions,
        map_sigma_m=map_sigma_m,
        threads=threads,
        looks=looks,
        light=light,
    )
    view = pinhole_view(model)
    if method in ON_PIXELS:
        return behind_the_lens(ON_PIXELS[method](view, settings), model)
    if method not in ON_FEATURES:
        raise ConfigError(f"unknown method {method!r}", where="localiser.method", remedy=f"use one of {', '.join(METHODS)}")
    if features is None:
        raise ConfigError(
            f"method {method!r} needs a network's features and got none",
            where="localiser.method",
            remedy="open a network (open_features_for), or use one of " + ", ".join(ON_PIXELS),
        )
    return behind_the_lens(ON_FEATURES[method](view, settings, features), model)
