"""Answers that also say how the camera turned."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.errors import Reason
from visloc_companion.localise.with_turn import WithTurn
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, Image, LocaliseRequest, NoFix

MODEL = CameraModel(640, 480, 560.0, 560.0, 319.5, 239.5)


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
        asked = replace(asked, frame=replace(asked.frame, t_ns=1_000_000_000 + 200_000_000 * k, frame_id=k))
        pixels = support.render(flat, MODEL, p, euler)
        answers.append((localiser.localise(asked, pixels, flat), Blind().localise(asked, pixels, flat)))
    assert [replace(a, turn=None) for a, _ in answers] == [b for _, b in answers]
    assert answers[0][0].turn is None
    turn = answers[2][0].turn
    assert turn is not None
    assert turn.t_to_ns == answers[2][0].t_ns
    assert abs(2 * turn.q_from_to[3] - 0.03) < 0.003
