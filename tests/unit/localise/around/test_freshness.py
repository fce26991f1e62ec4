"""A camera that froze repeats its last picture; two exposures never agree in every pixel."""

from __future__ import annotations

from typing import cast

import numpy as np

from tests.unit.localise.witness import Witness
from visloc_companion.errors import Reason
from visloc_companion.localise.around.freshness import FreshFramesOnly
from visloc_companion.localise.seen_before import MOST
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior

NOWHERE = cast("ReferenceMap", None)
PRIOR = PosePrior(GeoPoint(47.0, 8.0, 100.0), (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.1)


def ask(localiser: Localiser, frame_id: int, pixels: Image, request_id: int = 1) -> NoFix:
    request = LocaliseRequest(request_id, FrameRef(70, 60, frame_id, 0, 4, 3, 1), PRIOR, 1)
    answer = localiser.localise(request, pixels, NOWHERE)
    assert isinstance(answer, NoFix)
    return answer


def picture(seed: int) -> Image:
    return np.random.default_rng(seed).integers(0, 255, (3, 4), dtype=np.uint8)


def test_pictures_that_differ_in_one_bit_are_asked_about() -> None:
    witness = Witness()
    fresh, still = FreshFramesOnly(witness), picture(1)
    nearly = still.copy()
    nearly[2, 3] ^= 1
    assert [ask(fresh, n, pixels).reason for n, pixels in enumerate((still, nearly))] == [Reason.NO_MATCH] * 2
    assert witness.asked == [0, 1]
    assert fresh.method == "witness"


def test_a_repeated_picture_is_refused_until_another_one_comes() -> None:
    witness = Witness()
    fresh = FreshFramesOnly(witness)
    ask(fresh, 1, picture(1))
    refused = ask(fresh, 2, picture(1), request_id=9)
    assert refused.reason is Reason.FROZEN
    assert "frozen" in refused.detail
    assert (refused.request_id, refused.frame_id, refused.t_ns, refused.method) == (9, 2, 60, "witness")
    assert ask(fresh, 3, picture(1)).reason is Reason.FROZEN
    assert ask(fresh, 4, picture(2)).reason is Reason.NO_MATCH
    assert witness.asked == [1, 4]


def test_a_driver_that_hands_out_its_buffers_over_and_over_is_frozen() -> None:
    """Each picture differs from the one before."""
    witness = Witness()
    fresh = FreshFramesOnly(witness)
    answers = [ask(fresh, n, picture(n % 8)) for n in range(100)]
    assert witness.asked == list(range(8))
    assert {answer.reason for answer in answers[8:]} == {Reason.FROZEN}
    assert ask(fresh, 100, picture(8)).reason is Reason.NO_MATCH


def test_no_more_pictures_are_remembered_than_a_pipeline_holds() -> None:
    fresh = FreshFramesOnly(Witness())
    assert [ask(fresh, n, picture(n % (MOST + 1))).reason for n in range(3 * MOST)] == [Reason.NO_MATCH] * 3 * MOST


def test_the_same_frame_may_be_asked_about_again() -> None:
    """With another prior one frame can be tried twice; a refused frame stays refused."""
    witness = Witness()
    fresh = FreshFramesOnly(witness)
    assert [ask(fresh, 1, picture(1)).reason for _ in range(2)] == [Reason.NO_MATCH] * 2
    assert [ask(fresh, 2, picture(1)).reason for _ in range(2)] == [Reason.FROZEN] * 2


def test_pixels_need_not_be_contiguous() -> None:
    fresh = FreshFramesOnly(Witness())
    wide = np.repeat(picture(3), 2, axis=1)
    ask(fresh, 1, wide[:, ::2])
    assert ask(fresh, 2, picture(3)).reason is Reason.FROZEN
