"""Names to localisers: which need features, and what is said where they are missing."""

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise import registry
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.registry import METHODS, ON_FEATURES, make_localiser, needs_features
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Fix, GeoPoint, Image, LocaliseRequest, NoFix

MODEL = CameraModel(160, 120, 150.0, 150.0, 79.5, 59.5)


class OnFeatures:
    method = "on-features"

    def __init__(self, model: CameraModel, settings: LocaliserSettings, features: Features) -> None:
        self.features = features

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> NoFix:
        raise NotImplementedError


def test_every_name_is_there_once() -> None:
    assert len(set(METHODS)) == len(METHODS)
    assert {"gradient", "ncc", "keypoint"} <= set(METHODS)


def test_a_method_on_features_gets_them_or_says_that_it_needs_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.ON_FEATURES, "on-features", OnFeatures)
    made: Any = make_localiser("on-features", MODEL, features=GRADIENT)
    assert made.features is GRADIENT
    with pytest.raises(ConfigError, match=r"localiser.method: method 'on-features' needs a network's features and got none"):
        make_localiser("on-features", MODEL)


@pytest.mark.parametrize("method", METHODS)
def test_what_a_method_needs_is_enough(method: str) -> None:
    assert needs_features(method) == (method in ON_FEATURES)
    assert make_localiser(method, MODEL, features=GRADIENT if needs_features(method) else None).method == method


def test_features_that_nobody_needs_are_no_error() -> None:
    assert make_localiser("gradient", MODEL, features=GRADIENT).method == "gradient"


@pytest.mark.parametrize("method", METHODS)
def test_all_time_that_a_map_takes_to_be_read_is_the_maps_side(method, flat, support) -> None:
    """Of a large GeoTIFF without overviews the window for the plan alone takes ten times as long as all else."""
    n_read = 0

    class SlowMap(support.FlatMap):
        def patch(self, *window):
            nonlocal n_read
            n_read += 1
            time.sleep(0.2)
            return super().patch(*window)

    slow = SlowMap(flat.pixels, np.full(flat.pixels.shape[:2], 100, np.float32))
    frame = support.render(flat, MODEL, (5.0, 8.0, -240.0), (0.0, 0.0, 0.6))
    localiser = make_localiser(method, MODEL, features=GRADIENT if needs_features(method) else None)
    answer = localiser.localise(support.request_at((0.0, 0.0, -240.0), (0.0, 0.0, 0.6)), frame, slow)
    assert n_read >= 2
    assert dict(answer.evidence)["map_ms"] >= 200 * n_read


@pytest.mark.parametrize("method", METHODS)
def test_what_the_tilt_may_be_off_by_is_claimed(method, flat, support) -> None:
    """140 m above the ground a camera that leans by three degrees more than was thought looks as one 7 m beside it."""
    truth, lean_rad = (5.0, 8.0, -240.0), math.radians(3)
    frame = support.render(flat, MODEL, truth, (lean_rad, 0.0, 0.6))
    asked = support.request_at(truth, (0.0, 0.0, 0.6))
    asked = replace(asked, prior=replace(asked.prior, sigma_tilt_rad=lean_rad))
    localiser = make_localiser(method, MODEL, features=GRADIENT if needs_features(method) else None, max_probability_wrong=1.0)
    answer = localiser.localise(asked, frame, flat)
    assert isinstance(answer, Fix), answer
    off_m = ned_from_geo(answer.place, GeoPoint(47.0, 8.0, 0.0))[:2] - np.array(truth[:2])
    assert off_m @ np.linalg.solve(np.array(answer.cov_ne_m2), off_m) < 9.21, "99 % of two degrees of freedom"
