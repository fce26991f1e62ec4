"""Frames of a camera that zoomed in flight are looked at through the lens that would have taken them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.unit.level_ground import apart, level_ground, over_its_middle
from tests.unit.localise.mapped.test_light import EVENING, MORNING, photograph, wood
from visloc_companion.app.localiser import configured_localiser
from visloc_companion.config import LocaliserConfig
from visloc_companion.errors import Reason
from visloc_companion.geo.camera import project
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.around.zoomed import Zoomed, enlarged
from visloc_companion.localise.mapped import map_suns, relit_tiles
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.types import CameraMask, CameraModel, Fix, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior

MODEL = CameraModel(320, 240, 250.0, 252.0, 163.0, 117.0, (-0.2, 0.05, 0.001, -0.001, 0.0))
PLACE, Q = over_its_middle(100.0), quat_from_euler(0.1, -0.05, 0.7)
PICTURE = np.zeros((240, 320, 3), np.uint8)


def zoomed_picture(picture: Image, factor: float) -> Image:
    """As a digital zoom makes it: the middle, so many times larger."""
    height, width = picture.shape[:2]
    to_px = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, factor)
    return np.asarray(cv2.warpAffine(picture, to_px, (width, height), flags=cv2.INTER_LINEAR), np.uint8)


@pytest.mark.parametrize("factor", [1.5, 2.2])
def test_the_enlarged_lens_takes_the_picture_that_a_digital_zoom_makes(factor: float) -> None:
    scene = level_ground()
    plain = CameraSimulator(scene, MODEL).frame(PLACE, Q)
    zoomed = zoomed_picture(plain, factor)
    taken = CameraSimulator(scene, enlarged(MODEL, factor)).frame(PLACE, Q)
    soft = [cv2.GaussianBlur(each, (0, 0), 2.0) for each in (taken, zoomed, plain)]
    assert apart(soft[0], soft[1]) < 0.15 * apart(soft[0], soft[2])


def test_a_pixel_moves_away_from_the_pictures_middle_and_a_mask_with_it() -> None:
    ground = np.ones((240, 320), np.bool_)
    ground[100:120, 60:90] = False
    masked = replace(MODEL, mask=CameraMask.of(ground))
    rays = np.array([[0.1, -0.2, 1.0], [-0.3, 0.1, 1.0]])
    middle = np.array([159.5, 119.5])
    assert project(enlarged(masked, 1.5), rays) == pytest.approx(middle + 1.5 * (project(masked, rays) - middle))
    mask = enlarged(masked, 1.5).mask
    assert mask is not None
    rows, columns = np.nonzero(~mask.ground())
    assert (rows.min(), rows.max()) == pytest.approx((119.5 + 1.5 * (99.5 - 119.5), 119.5 + 1.5 * (119.5 - 119.5)), abs=1.5)
    assert (columns.min(), columns.max()) == pytest.approx((159.5 + 1.5 * (59.5 - 159.5), 159.5 + 1.5 * (89.5 - 159.5)), abs=1.5)
    smaller = enlarged(masked, 0.5).mask
    assert smaller is not None
    assert not smaller.ground()[:50].any()


class Knows:
    """protocols.Localiser: recognises frames through the right lens alone."""

    method = "test"

    def __init__(self, model: CameraModel, right: float, made: list[float], why: Reason = Reason.NO_MATCH) -> None:
        self.zoom, self.right, self.why = model.fx_px / MODEL.fx_px, right, why
        made.append(round(self.zoom, 3))

    def localise(self, request: LocaliseRequest, pixels: Image, ref: object) -> Fix | NoFix:
        ids = request.request_id, request.frame.frame_id, "test"
        if abs(self.zoom / self.right - 1) > 0.05:
            return NoFix(0, request.frame.t_ns, *ids, self.why, 7.0)
        cov = ((1.0, 0.0), (0.0, 1.0))
        return Fix(0, request.frame.t_ns, *ids, request.prior.place, request.prior.q_ned_frd, cov, 1.0, 0.01, 0.001, 5.0)


def answers(
    asked: list[tuple[float, float | None]], right: float, why: Reason = Reason.NO_MATCH
) -> tuple[list[Fix | NoFix], list[float]]:
    made: list[float] = []

    def of(model: CameraModel) -> Knows:
        return Knows(model, right, made, why)

    localiser = Zoomed(of(MODEL), of, of, MODEL)
    prior = PosePrior(GeoPoint(59.0, 18.0, 100.0), Q, ((9.0, 0.0), (0.0, 9.0)), 3.0, 0.05, 0.02)
    requests = [
        LocaliseRequest(k, FrameRef(k, k, k, 0, 320, 240, 3), prior, 1, zoom=zoom, try_zoom=tried)
        for k, (zoom, tried) in enumerate(asked)
    ]
    return [localiser.localise(request, PICTURE, None) for request in requests], made  # type: ignore[arg-type]


def test_a_refusal_bears_the_fix_that_another_lens_gives() -> None:
    (plain, wrong, right), made = answers([(1.0, None), (1.0, 1.2), (1.0, 1.5)], 1.5)
    assert isinstance(plain, NoFix)
    assert isinstance(wrong, NoFix)
    assert plain.zoomed is wrong.zoomed is None
    assert isinstance(right, NoFix)
    assert right.zoomed is not None
    assert right.elapsed_ms == 12.0
    assert made == [1.0, 1.2, 1.5]


def test_a_zoom_that_is_believed_keeps_its_localiser_while_others_are_tried() -> None:
    found, made = answers([(1.5, None), (1.5, 1.0), (1.5, None)], 1.5)
    assert all(isinstance(each, Fix) for each in found)
    assert made == [1.0, 1.5]


def test_a_picture_that_shows_nothing_is_not_looked_at_again() -> None:
    (found,), made = answers([(1.0, 1.5)], 1.5, Reason.TOO_DARK)
    assert isinstance(found, NoFix)
    assert found.zoomed is None
    assert made == [1.0]


@pytest.mark.parametrize("factor", [1.5, 0.75])
def test_what_flies_finds_the_place_in_a_zoomed_picture(flat: Any, support: Any, factor: float) -> None:
    model = CameraModel(320, 240, 280.0, 280.0, 159.5, 119.5)
    truth, euler = (5.0, 8.0, -240.0), (0.05, -0.1, 0.3)
    picture = support.render(flat, enlarged(model, factor), truth, euler)
    config = LocaliserConfig(method="gradient", structure=False, check_every=0)
    localiser, _ = configured_localiser(config, model)
    asked = support.request_at((0.0, 0.0, -240.0), euler, model=model)
    plain = localiser.localise(asked, picture, flat)
    assert isinstance(plain, NoFix)
    tried = localiser.localise(replace(asked, frame=replace(asked.frame, frame_id=4, t_ns=3), try_zoom=factor), picture + 1, flat)
    assert isinstance(tried, NoFix)
    assert tried.zoomed is not None
    believed = localiser.localise(replace(asked, frame=replace(asked.frame, frame_id=5, t_ns=4), zoom=factor), picture, flat)
    assert isinstance(believed, Fix)
    for found in (tried.zoomed, believed):
        north, east, down = ned_from_geo(found.place, support.HOME)
        assert (north, east) == pytest.approx(truth[:2], abs=2.0)
        assert down == pytest.approx(truth[2], abs=4.0)


def test_what_is_worked_out_of_the_maps_light_serves_every_lens(support: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each lens that was tried on a frame looked for the sun over the map anew, and relit the same ground."""
    up = wood(7, 700, 0.9)
    known, flown = (support.FlatMap(np.asarray(photograph(up, sun, 3), dtype=np.uint8), up) for sun in (MORNING, EVENING))
    tiles, suns = [], []
    relit, sun_about = relit_tiles._made, map_suns._sun_about

    def made(ref: Any, light: Any, pixel: float, col: int, row: int, features: Any) -> Any:
        tiles.append((light, pixel, col, row, features.name))
        return relit(ref, light, pixel, col, row, features)

    def looked_for(ref: Any, frame: Any, ne_m: Any) -> Any:
        suns.append(tuple(round(at) for at in frame.to_map(ne_m)))
        return sun_about(ref, frame, ne_m)

    monkeypatch.setattr(relit_tiles, "_made", made)
    monkeypatch.setattr(map_suns, "_sun_about", looked_for)
    model, level = CameraModel(320, 240, 280.0, 280.0, 159.5, 119.5), (0.0, 0.0, 0.6)
    localiser, _ = configured_localiser(LocaliserConfig(method="gradient", structure=False, check_every=0), model)
    for k, zoom in enumerate((1.0, 1.2, 1.1, 1.0)):
        truth = (-20.0 + 10 * k, 10.0, -270.0)
        picture = support.render(flown, enlarged(model, zoom), truth, level)
        asked = support.request_at((truth[0] + 3.0, truth[1] - 2.0, truth[2]), level, sigma_m=6.0, model=model)
        prior, frame = replace(asked.prior, sun=EVENING), replace(asked.frame, frame_id=k, t_ns=k * 1_000_000_000)
        answer = localiser.localise(replace(asked, prior=prior, frame=frame, zoom=zoom), picture, known)
        assert isinstance(answer, Fix)
        assert dict(answer.evidence)["lit"] == 1.0
    assert len(tiles) == len(set(tiles)) > 0
    assert len(suns) == len(set(suns)) > 0
