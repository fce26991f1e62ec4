"""Answers that also say how the camera turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.around.freshness import FreshFramesOnly
from visloc_companion.localise.around.with_turn import WithTurn
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Image, LocaliseRequest, NoFix, TiltBefore, TiltPrior

MODEL = CameraModel(640, 480, 560.0, 560.0, 319.5, 239.5)


def of_frame(request: LocaliseRequest, k: int) -> LocaliseRequest:
    """The same question about the k-th frame, five a second."""
    return replace(request, frame=replace(request.frame, t_ns=1_000_000_000 + 200_000_000 * k, frame_id=k))


class Blind:
    """Finds nothing."""

    method = "blind"

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> NoFix:
        return NoFix(0, request.frame.t_ns, request.request_id, request.frame.frame_id, self.method, Reason.NO_MATCH, 1.0)


def test_the_answer_stays_what_it_was_and_bears_the_turn(support, flat) -> None:
    localiser = WithTurn(Blind(), MODEL)
    assert localiser.method == "blind"
    answers = []
    for k in range(3):
        p, euler = (4.0 * k, 10.0, -200.0), (0.0, 0.02 * k, 0.03 * k)
        asked = support.request_at(p, euler, model=MODEL)
        asked = of_frame(asked, k)
        pixels = support.render(flat, MODEL, p, euler)
        answers.append((localiser.localise(asked, pixels, flat), Blind().localise(asked, pixels, flat)))
    assert [replace(a, turn=None, turn_since_kept=None) for a, _ in answers] == [b for _, b in answers]
    assert answers[0][0].turn is None
    turn = answers[2][0].turn
    assert turn is not None
    assert turn.t_to_ns == answers[2][0].t_ns
    assert abs(2 * turn.q_from_to[3] - 0.03) < 0.003


def test_an_old_picture_of_a_frozen_camera_tells_of_no_turn(support, flat) -> None:
    """Of a ring of buffers: neither the one before nor the last that was new."""
    localiser = WithTurn(FreshFramesOnly(Blind()), MODEL)
    p, answers = (0.0, 10.0, -200.0), []
    eulers = [(0.0, 0.02 * k, 0.03 * k) for k in range(5)]
    pictures = [support.render(flat, MODEL, p, euler) for euler in eulers]
    pictures[2] = pictures[0]
    for k, pixels in enumerate(pictures):
        answers.append(localiser.localise(of_frame(support.request_at(p, eulers[k], model=MODEL), k), pixels, flat))
    assert [answer.reason is Reason.FROZEN for answer in answers] == [False, False, True, False, False]
    assert [answer.turn is None for answer in answers] == [True, False, True, True, False]


class Listening(Blind):
    """Remembers what prior it was given."""

    def __init__(self) -> None:
        self.tilts: list[TiltPrior | None] = []

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> NoFix:
        self.tilts.append(request.prior.tilt)
        return super().localise(request, pixels, ref)


@pytest.mark.parametrize(("known_rad", "carried"), [(0.01, True), (1e-4, False)])
def test_the_tilt_of_the_frame_before_is_carried_on(support, flat, known_rad: float, carried: bool) -> None:
    inner = Listening()
    localiser, last = WithTurn(inner, MODEL), None
    for k in range(3):
        p, euler, off_rad = (4.0 * k, 10.0, -200.0), (0.0, 0.02 * k, 0.03 * k), 0.005 * k  # the reported attitude gains an error
        asked = support.request_at(p, (euler[0] - off_rad, euler[1], euler[2]), model=MODEL)
        tilt = TiltPrior((0.0, 0.0), known_rad, None if last is None else TiltBefore(*last, (0.005 * (k - 1), 0.0), 1e-3))
        asked = of_frame(asked, k)
        asked = replace(asked, prior=replace(asked.prior, tilt=tilt))
        last = asked.frame.t_ns, asked.prior.q_ned_frd
        localiser.localise(asked, support.render(flat, MODEL, p, euler), flat)
    told = inner.tilts[2]
    assert told is not None
    assert told.turn_ne_rad[0] == pytest.approx(0.010 if carried else 0.0, abs=2.5e-3)
    assert (told.sigma_rad < known_rad) is carried
    assert inner.tilts[0] == TiltPrior((0.0, 0.0), known_rad)


@pytest.mark.parametrize(("turned_rad", "least_rad", "most_rad"), [(0.01, 0.0, 0.0007), (0.15, 0.0022, 0.004)])
def test_a_large_turn_carries_the_tilt_no_better_than_the_lens_is_known(
    support, flat, turned_rad: float, least_rad: float, most_rad: float
) -> None:
    inner = Listening()
    localiser = WithTurn(inner, MODEL)
    for k in range(2):
        p, euler = (4.0 * k, 10.0, -200.0), (0.0, turned_rad * k, 0.0)
        asked = support.request_at(p, euler, model=MODEL)
        before = TiltBefore(1_000_000_000, support.request_at(p, (0.0, 0.0, 0.0), model=MODEL).prior.q_ned_frd, (0.0, 0.0), 1e-4)
        tilt = TiltPrior((0.0, 0.0), 0.01, before if k else None)
        asked = of_frame(asked, k)
        localiser.localise(replace(asked, prior=replace(asked.prior, tilt=tilt)), support.render(flat, MODEL, p, euler), flat)
    told = inner.tilts[1]
    assert told is not None
    assert least_rad < told.sigma_rad < most_rad


def test_a_place_without_coordinates_in_the_maps_crs_hides_no_turn(support, flat, elsewhere) -> None:
    localiser, turns = WithTurn(Blind(), MODEL), []
    for k in range(2):
        p, euler = (4.0 * k, 10.0, -200.0), (0.0, 0.0, 0.03 * k)
        asked = of_frame(support.request_at(p, euler, model=MODEL), k)
        turns.append(localiser.localise(asked, support.render(flat, MODEL, p, euler), elsewhere).turn)
    assert turns[1] is not None


def test_a_frame_without_corners_bears_no_turn(support, flat) -> None:
    localiser = WithTurn(Blind(), MODEL)
    for k in range(2):
        asked = support.request_at((0.0, 0.0, -200.0), (0.0, 0.0, 0.0), model=MODEL)
        asked = of_frame(asked, k)
        assert localiser.localise(asked, np.full((480, 640), 90 + k, np.uint8), flat).turn is None


def test_the_turn_rests_on_the_maps_surface(support, flat) -> None:
    """Beside a table mountain of a quarter of the height, over the same picture."""
    up = flat.surface.copy()
    up[: up.shape[0] // 2, up.shape[1] // 2 :] += 40.0
    relief = support.FlatMap(flat.pixels, up)
    errors = {}
    for name, known in (("mountain", relief), ("level", flat)):
        localiser, off = WithTurn(Blind(), MODEL), []
        for k in range(8):
            p, euler = (2.0 * k - 8.0, 5.0 * k - 20.0, -260.0), (0.01 * k, 0.0, 0.0)
            asked = support.request_at(p, euler, model=MODEL)
            asked = of_frame(asked, k)
            turn = localiser.localise(asked, support.render(relief, MODEL, p, euler), known).turn
            if turn is not None:
                off.append([2 * turn.q_from_to[1] - 0.01, 2 * turn.q_from_to[2]])
        assert len(off) >= 6
        errors[name] = np.degrees(np.abs(np.mean(off, axis=0)).max())
    assert errors["mountain"] < 0.5 * errors["level"]
    assert errors["mountain"] < 0.06
