"""Corners followed between frames of different heights."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.structure import tracks
from visloc_companion.localise.structure.base import StereoSettings
from visloc_companion.localise.structure.pairs import Star
from visloc_companion.localise.structure.view import View, view_of


def followed(structure, town, ups: tuple[float, float]) -> tracks.Tracks:
    poses = [structure.pose(0.0, 0.2 * ups[0] * k, up) for k, up in enumerate(ups)]
    frames = [
        structure.posed(town.render(structure.MODEL, T, seed=k), T, up) for k, (T, up) in enumerate(zip(poses, ups, strict=True))
    ]
    greys = {k: frame.pixels for k, frame in enumerate(frames)}
    return tracks.follow(frames, greys, Star(0, (1,), (1.0,), (0.2,)), structure.MODEL, StereoSettings())


@pytest.mark.parametrize("ups", [(60.0, 100.0), (100.0, 60.0)])
def test_corners_are_found_again_in_a_picture_of_another_height(structure, town, ups) -> None:
    """From 100 m to 60 m a third of the ground is seen again."""
    found = followed(structure, town, ups)
    assert len(found.of(1)[0]) > 40


def test_pictures_are_enlarged_no_more_than_memory_allows(structure, town, monkeypatch) -> None:
    """A vehicle that shot up: the last frame sees ten times the ground of the first."""
    views: list[View] = []

    def drawn(*asked) -> View:
        views.append(view_of(*asked))
        return views[-1]

    monkeypatch.setattr(tracks, "view_of", drawn)
    followed(structure, town, (12.0, 120.0))
    np.testing.assert_allclose([view.focal_px / structure.MODEL.fx_px for view in views], [1.0, tracks.MOST_ENLARGED])
