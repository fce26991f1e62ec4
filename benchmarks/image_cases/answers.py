"""Every answer of a method on a set of cases, kept on disk: a run that was broken off goes on, a refit needs no new run.

Answers are taken whatever their claimed probability of being wrong, so that any limit can be applied afterwards, and stored
without the map's own error, which is added where they are handed out; what the evidence makes of that probability is computed
there, too. The file's name holds digests of the code (and of the model) that gave them and of the cases: answers of others are
never mixed in. Where two looks at a frame were taken, the coefficients chose one, so they are part of the name, too.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.image_cases.cases import PROJECT
from visloc_companion.app.serialise import from_dict
from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_cases, read_truth
from visloc_companion.evaluate.images.image import run_cases
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.evaluate.images.map_sigma import MapSigma, with_map_sigma
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.localise.settings import Looks
from visloc_companion.localise.verify import (
    AGAIN_WEIGHTS,
    DEEP_WEIGHTS,
    GRADIENT_WEIGHTS,
    QUARTER_WEIGHTS,
    Evidence,
    Weights,
    beside_others,
    left_to_place,
    probability_wrong,
    unknown_attitude_wrong,
)
from visloc_companion.types import Fix

Judged = tuple[CaseResult, Truth]
Named = TypeVar("Named", bound=CaseResult | Case | BadCase)
PACKAGE = PROJECT / "visloc_companion"
CODE = ("localise", "maps", "geo")
TAKE_ALL = 1.0
WEIGHTS: dict[str, Weights] = {"gradient": GRADIENT_WEIGHTS, "deep": DEEP_WEIGHTS}
EXACT, UNSTATED = MapSigma(0.0, 0.0, 0.0), MapSigma()
RENDERED = MapSigma(0.0, 0.0, UNSTATED.height_m)
"""Of a made world: its dates are registered exactly, its surface has changed."""


def code_digest(model: Path | None, *, without_verdict: bool = False) -> str:
    """Twelve hexadecimal digits of what determines the answers: the code of the localisers and the model's manifest.

    `without_verdict` leaves out verify.py, whose coefficients turn the evidence into a probability and change no evidence.
    """
    digest = hashlib.sha256()
    for room in CODE:
        for path in sorted((PACKAGE / room).rglob("*.py")):
            if not (without_verdict and path.name == "verify.py"):
                digest.update(path.name.encode() + path.read_bytes())
    folders = [model] if model else sorted((PROJECT / "models").glob("*"))
    for folder in folders:
        manifest = folder / "manifest.json"
        if manifest.exists():
            digest.update(manifest.read_bytes())
    return digest.hexdigest()[:12]


def answers(
    folder: Path,
    method: str,
    store: Path,
    digest: str,
    jobs: int = 1,
    limit: int | None = None,
    model: Path | None = None,
    map_sigma: MapSigma = UNSTATED,
    looks: Looks = Looks.BOTH,
) -> list[Judged]:
    """Answers and truths of the first `limit` cases of a folder: from the store, or computed and stored."""
    cases, truth = read_cases(folder)[:limit], read_truth(folder)
    of_cases = hashlib.sha256((folder / "cases.csv").read_bytes()).hexdigest()[:8]
    file = store / f"{folder.name}.{method}{_by_which(method, looks)}.{digest}.{of_cases}.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)
    kept = _read(file)
    missing = [case for case in cases if case.case_id not in kept]
    if missing:
        started = time.monotonic()
        with file.open("a", encoding="utf-8") as stream:
            for k, result in enumerate(run_cases(missing, method, jobs, TAKE_ALL, NetworkChoice(model), EXACT, looks), 1):
                stream.write(json.dumps(_as_json(result)) + "\n")
                stream.flush()
                kept[result.case_id] = result
                _progress(f"{folder.name} {method}", k, len(missing), started)
    handed = ((case.case_id, _off_by(judged_anew(kept[case.case_id], method), map_sigma)) for case in cases)
    return [(named(result, folder), truth[case_id]) for case_id, result in handed if case_id in truth]


def judged_anew(result: CaseResult, method: str) -> CaseResult:
    """The result with the probability that the coefficients of verify.py make of its evidence now."""
    if result.fix is not None and method == "cross-view":
        p = unknown_attitude_wrong(result.evidence)
        return replace(result, fix=replace(result.fix, probability_wrong=p), evidence=result.evidence | {"p_wrong": p})
    if result.fix is None or method not in WEIGHTS:
        return result
    weights = AGAIN_WEIGHTS if result.evidence["looks"] > 1 else WEIGHTS[method]
    alone = probability_wrong(Evidence.from_numbers(result.evidence), weights, result.evidence.get("quarters"))
    p = beside_others(alone, left_to_place(result.evidence))
    return replace(result, fix=replace(result.fix, probability_wrong=p), evidence=result.evidence | {"p_wrong": p})


def _off_by(result: CaseResult, map_sigma: MapSigma) -> CaseResult:
    return result if result.fix is None else replace(result, fix=with_map_sigma(result.fix, map_sigma))


def _by_which(method: str, looks: Looks) -> str:
    """Part of the file's name: which looks decided and, where one of two was chosen, by which coefficients."""
    if looks is not Looks.BOTH:
        return f".{looks.value}"
    chose = repr((DEEP_WEIGHTS, AGAIN_WEIGHTS, QUARTER_WEIGHTS)).encode()
    return f".{hashlib.sha256(chose).hexdigest()[:8]}" if method == "deep" else ""


def named(of_case: Named, folder: Path) -> Named:
    """A case or its result with an id that is unique over all folders."""
    return replace(of_case, case_id=f"{folder.name}/{of_case.case_id}")


def _read(file: Path) -> dict[str, CaseResult]:
    if not file.exists():
        return {}
    whole = file.read_text(encoding="utf-8")
    lines = whole.split("\n")
    if lines.pop():  # broken off within a line
        file.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return {(result := _from_json(json.loads(line))).case_id: result for line in lines}


def _as_json(result: CaseResult) -> dict[str, Any]:
    document = asdict(result)
    document["reason"] = str(result.reason) if result.reason is not None else None
    return document


def _from_json(document: dict[str, Any]) -> CaseResult:
    fix = None if document["fix"] is None else from_dict({"type": Fix.__name__} | document["fix"])
    reason = Reason(document["reason"]) if document["reason"] is not None else None
    size = document.get("frame_px")
    return CaseResult(**document | {"fix": fix, "reason": reason, "frame_px": None if size is None else (size[0], size[1])})


def _progress(what: str, done: int, total: int, started: float) -> None:
    if done % 20 and done != total:
        return
    left_s = (time.monotonic() - started) / done * (total - done)
    print(f"{what}: {done} of {total}, {left_s:.0f} s left", file=sys.stderr, flush=True)
