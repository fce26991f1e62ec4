"""The worst cases of an image evaluation, with their pictures."""

from __future__ import annotations

from collections.abc import Sequence

from visloc_companion.evaluate.cases import BadCase, Case, Truth
from visloc_companion.evaluate.images.image_metrics import CaseError, CaseResult, case_error
from visloc_companion.evaluate.images.image_pictures import CasePictures, case_pictures
from visloc_companion.evaluate.reports.report_parts import case_section, worst_cases_section

WORST = 10
EVIDENCE = ("score", "runner_up", "blocks_agreeing", "blocks", "scatter_px", "position_sigmas", "height_sigmas", "yaw_sigmas")
Judged = tuple[CaseResult, Truth]


def worst_cases(
    judged: Sequence[Judged], count: int, max_probability_wrong: float = 1.0
) -> list[tuple[CaseResult, Truth, CaseError]]:
    """Accepted far-off fixes first, then the other answers by their error in pixels.

    An answer where there is no right one counts as accepted and far, or comes last.
    """
    answers = [(r, t, e) for r, t in judged if (e := case_error(r, t)) is not None]

    def badness(item: tuple[CaseResult, Truth, CaseError]) -> tuple[bool, float]:
        result, _, error = item
        p = result.fix.probability_wrong if result.fix is not None else 1.0
        return error.far and p <= max_probability_wrong, error.horizontal_px if error.solvable else 1 - p

    return sorted(answers, key=badness, reverse=True)[:count]


def worst_section(judged: Sequence[Judged], cases: dict[str, Case | BadCase], max_probability_wrong: float) -> str:
    """HTML of the worst cases whose files can be read; empty without any."""
    shown = []
    for result, truth, error in worst_cases(judged, WORST, max_probability_wrong) if cases else ():
        pictures = case_pictures(cases[result.case_id], truth, result) if result.case_id in cases else None
        if pictures is not None:
            shown.append(_one(result, truth, error, pictures, max_probability_wrong))
    return worst_cases_section(shown)


def _one(result: CaseResult, truth: Truth, error: CaseError, pictures: CasePictures, max_probability_wrong: float) -> str:
    p = result.fix.probability_wrong if result.fix is not None else 1.0
    verdict = "accepted" if p <= max_probability_wrong else "refused"
    words = f"{error.horizontal_px:.1f} px ({error.horizontal_m:.1f} m) off" if error.solvable else "there is no right answer"
    evidence = ", ".join(f"{name} {result.evidence[name]:.3g}" for name in EVIDENCE if name in result.evidence)
    dates = f"map of {truth.map_date}, frame of {truth.frame_date}" if truth.map_date else ""
    shots = (
        (pictures.frame_at_truth, "frame, laid out at the truth"),
        (pictures.map_at_truth, "map at the truth"),
        (pictures.frame_at_answer, "frame, laid out at the answer"),
        (pictures.map_at_answer, "map at the answer"),
    )
    note = "; ".join(x for x in (dates, evidence) if x)
    return case_section(result.case_id, f"{words}, claimed p {p:.3g} ({verdict})", note, shots)
