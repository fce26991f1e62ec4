"""Cases of cloud registration for the benchmarks, made by the shared tool."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.image_cases.cases import SHARED
from visloc_companion.localise.registration.base import RegistrationPrior

Array = NDArray[np.float64]
MAKER = SHARED / "tools" / "make_cloud_cases.py"
LEVELS = ("normal", "hard")
COVER = {
    "delft_ahn3": "buildings",
    "suburb_fusa": "buildings",
    "ign_suburb_sparse": "mixed",
    "autzen_park": "field",
    "bc_conifer_south": "forest",
    "quebec_lakes": "forest",
    "eucalyptus_farm": "forest",
    "bragg_west": "gullies",
    "afsluitdijk_water": "water",
    "made_water": "water",
    "made_field": "bare",
    "made_furrows": "bare",
    "made_tree_row": "bare",
    "elsewhere": "foreign",
}
BLANK = ("water", "bare", "foreign")
"""Covers on which there is nothing to be found, or hardly anything."""
FITTED = ("delft_ahn3", "autzen_park", "quebec_lakes", "eucalyptus_farm")
"""Places that methods and claims are fitted on; all others only judge them."""
SPARSE = 0.28
"""Points per square metre of the thinnest reference."""


@dataclass(frozen=True, slots=True, eq=False)
class CloudCase:
    """Clouds in metres, the prior, and the true similarity (4, 4); None where the source shows another place."""

    name: str
    cloud: str
    scenario: str
    level: str
    source_m: Array
    reference_m: Array
    prior: RegistrationPrior
    T_true: Array | None

    @property
    def cover(self) -> str:
        """Land cover of the cloud; other clouds are "other"."""
        return COVER.get(self.cloud, "other")


def make(clouds: Path, folder: Path, level: str, n: int, seed: int) -> Path:
    """The folder of so many cases a cloud and scenario, made where they are not there yet."""
    folder = folder / f"{level}_{seed}_{n}"
    if (folder / "cases.json").exists():
        return folder
    if not MAKER.exists():
        raise SystemExit(f"{MAKER} is missing: the benchmarks need the shared folder beside the project")
    command = [sys.executable, str(MAKER), str(clouds), str(folder), "--cases", str(n), "--seed", str(seed)]
    subprocess.run([*command, "--degradation", level], check=True, stdout=sys.stderr)
    return folder


def read(folder: Path, level: str, clouds: tuple[str, ...] | None = None) -> Iterator[CloudCase]:
    """The cases of a folder, of all clouds or of some."""
    truth = {t["id"]: t for t in json.loads((folder / "truth.json").read_text(encoding="utf-8"))}
    for case in json.loads((folder / "cases.json").read_text(encoding="utf-8")):
        true = truth[case["id"]]
        if clouds is None or true["cloud"] in clouds:
            source, reference = (np.load(folder / case[k])["points"].astype(np.float64) for k in ("source", "reference"))
            T = np.array(true["T_reference_source"])
            yield CloudCase(case["id"], true["cloud"], true["scenario"], level, source, reference, _prior(case), T)


def thinned(case: CloudCase, per_m2: float, seed: int) -> CloudCase:
    """The same on a reference that is thinned."""
    side = np.ptp(case.reference_m[:, :2], axis=0)
    share = per_m2 * float(side[0] * side[1]) / len(case.reference_m)
    keep = np.random.default_rng(seed).random(len(case.reference_m)) < share
    return replace(case, name=f"{case.name}_sparse", reference_m=case.reference_m[keep])


def elsewhere(case: CloudCase, other: CloudCase) -> CloudCase:
    """The source of one case on the reference of another cloud: there is no right place."""
    return replace(case, name=f"{case.name}_on_{other.name}", reference_m=other.reference_m, T_true=None)


def foreign(cases: Sequence[CloudCase]) -> Iterator[CloudCase]:
    """Each source over land on the reference of another cloud of its scenario, as a place named elsewhere."""
    land = [c for c in cases if c.cover not in BLANK]
    for k, case in enumerate(land):
        others = [c for c in land if c.cloud != case.cloud and c.scenario == case.scenario]
        yield replace(elsewhere(case, others[7 * k % len(others)]), cloud="elsewhere")


def _prior(case: dict[str, Any]) -> RegistrationPrior:
    return RegistrationPrior(
        case["sigma_horizontal_m"],
        case["sigma_vertical_m"],
        float(np.radians(case["sigma_yaw_deg"])),
        float(np.radians(case["sigma_tilt_deg"])),
        case["sigma_scale"],
    )
