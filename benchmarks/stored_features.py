"""What the pack's stored features cost and save: `python -m benchmarks.stored_features FOLDER [--n N] [--method NAME]`.

The same cases of the test rows of ../shared/data/naip are localised over three packs in turn: one without stored features
(computed for every window), one with features at the stored GSDs but not rounded to int8, and one as it flies. Prints a
markdown table: errors in map pixels, CPU time of a whole answer and of the map's windows in it.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.image_cases.cases import TEST_ROWS, CaseSet, make
from visloc_companion.evaluate.cases import Case, Truth, read_cases, read_frame, read_truth
from visloc_companion.geo.raster import compose_affine
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.warp import warp_affine
from visloc_companion.prepare.build import build_pack
from visloc_companion.types import FeaturePatch, Fix, FrameRef, GeoPoint, LocaliseRequest


class Unstored:
    """A pack as a map without stored features: protocols.ReferenceMap, not FeatureMap."""

    def __init__(self, pack: PackMap) -> None:
        self.gsd_m, self.patch, self.covers = pack.gsd_m, pack.patch, pack.covers
        self.projection_at, self.to_map, self.to_geo = pack.projection_at, pack.to_map, pack.to_geo
        self.height_amsl_m = pack.height_amsl_m


@dataclass(slots=True)
class Exact:
    """A pack whose stored features are computed again, unrounded, where they are asked for."""

    pack: PackMap
    functions: dict[str, Features]
    """The pack's functions by their names."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.pack, name)

    def stored_gsd_m(self, center_map_m: tuple[float, float], gsd_m: float, name: str, recipe: str) -> float | None:
        """As the pack's."""
        return self.pack.stored_gsd_m(center_map_m, gsd_m, name, recipe)

    def stored_patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, name: str, recipe: str
    ) -> FeaturePatch | None:
        """The pack's window with features of the pixels."""
        patch = self.pack.stored_patch(center_map_m, size_px, gsd_m, name, recipe)
        if patch is None:
            return None
        features = self.functions[name]
        m = features.context_px
        T_map_pix = compose_affine(patch.T_map_pix, np.array([[1.0, 0.0, -m], [0.0, 1.0, -m]]))
        image, valid = warp_affine(self.pack._pixels, T_map_pix, (size_px[0] + 2 * m, size_px[1] + 2 * m))
        values = features(image, valid, m)
        return FeaturePatch(values, patch.valid, patch.dsm_amsl_m, patch.T_map_pix, patch.gsd_m)


@dataclass(slots=True)
class Tally:
    """What came out over one kind of map."""

    cases: int = 0
    error_px: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    map_ms: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """A line of the table."""
        e = np.array(self.error_px)
        shares = f"{100 * np.sum(e < 5) / self.cases:.1f} % | {100 * np.sum(e < 2) / self.cases:.1f} %"
        errors = f"{e.mean():.3f} | {np.median(e):.3f} | {np.percentile(e, 95):.3f}"
        return f"| {name} | {self.cases} | {shares} | {errors} | {np.median(self.cpu_ms):.0f} | {np.median(self.map_ms):.1f} |"


def main() -> None:
    """Make cases and packs, localise, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--n", type=int, default=200)
    parser.add_argument("--kind", default="t2")
    parser.add_argument("--foot", type=float, default=173)
    parser.add_argument("--method", default="gradient")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    network = open_features_for(options.method, NetworkChoice(threads=1))
    cases = make(
        CaseSet(f"stored_{options.kind}_{options.foot:g}", options.kind, options.n, TEST_ROWS, 5, foot=options.foot),
        options.folder,
    )
    truth = read_truth(cases)
    tallies = {name: Tally() for name in ("computed in flight", "stored, not rounded", "stored as int8")}
    packs: dict[Path, tuple[Any, ...]] = {}
    for case in read_cases(cases):
        if not isinstance(case, Case):
            continue
        if case.ortho not in packs:
            packs[case.ortho] = _maps(case, options.folder, network)
        for tally, reference in zip(tallies.values(), packs[case.ortho], strict=True):
            _localise(case, truth[case.case_id], reference, options.method, network, tally)
    print("| map's features | n | < 5 px | < 2 px | mean px | median px | p95 px | CPU ms | of it map's windows ms |")
    print("|" + "---|" * 9)
    for name, tally in tallies.items():
        print(tally.row(name))


def _maps(case: Case, folder: Path, network: Features | None) -> tuple[Any, ...]:
    path = folder / "packs" / f"{case.ortho.parent.name}_{case.ortho.stem}_{network.name if network else GRADIENT.name}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        build_pack([case.ortho], case.dsm, path, networks=[network] if network else [])
    pack = PackMap.open(path, verify_hashes=False)
    functions = [GRADIENT] if network is None else [GRADIENT, network]
    return Unstored(pack), Exact(pack, {each.name: each for each in functions}), pack


def _localise(case: Case, truth: Truth, reference: Any, method: str, network: Features | None, tally: Tally) -> None:
    pixels = read_frame(case.frame)
    if pixels is None:
        raise SystemExit(f"{case.frame} cannot be read")
    model = case.camera.model(pixels)
    localiser = make_localiser(method, model, features=network)
    frame = FrameRef(0, 0, 0, 0, model.width_px, model.height_px, 1 if pixels.ndim == 2 else 3)
    start = time.process_time()
    answer = localiser.localise(LocaliseRequest(0, frame, case.prior, 1), pixels, reference)
    tally.cpu_ms.append(1e3 * (time.process_time() - start))
    tally.cases += 1
    if isinstance(answer, Fix):
        tally.error_px.append(distance_m(answer.place, GeoPoint(truth.lat_deg, truth.lon_deg, 0.0)) / reference.gsd_m)
    if "map_ms" in dict(answer.evidence):
        tally.map_ms.append(dict(answer.evidence)["map_ms"])


if __name__ == "__main__":
    main()
