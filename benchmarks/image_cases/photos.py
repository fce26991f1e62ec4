"""Cases of real drone photographs over a satellite map; only ever scored on, never fitted to.

The photographs of ../shared/data/drone_urban show a town; the map is a picture without a surface model, so roofs stand beside
their place on it. Positions are judged in metres (`gsd_m` = 1): the truth itself is good to 1.5 to 3.3 m.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.image_cases.cases import SHARED
from visloc_companion.evaluate.cases import COLUMNS

DATA = SHARED / "data" / "drone_urban"
M_PER_DEG_LAT, M_PER_DEG_LON = 110770.0, 111320.0
"""Metres per degree of latitude (at 24 degrees), and of longitude at the equator."""
TAKEOFF = {"id": "takeoff_5m", "lat_deg": 24.26114, "lon_deg": 120.72060, "h_m": 5.0}
"""A photograph from 5 m above the park: the prior of a vehicle that believes itself in the air where it is not."""


@dataclass(frozen=True, slots=True)
class PhotoPrior:
    """What the prior of the photographs knows. The position is off by up to `radius_m` (uniform over the disc, or always just
    that with `on_ring`), heading and height are off uniformly, the tilt by a Gaussian; with `nadir` the prior says 0 instead."""

    radius_m: float
    on_ring: bool = False
    yaw_deg: float = 5.0
    h_share: float = 0.05
    tilt_sigma_deg: float = 1.0
    nadir: bool = False


TILT_KNOWN = PhotoPrior(100.0, on_ring=True)
TILT_UNKNOWN = PhotoPrior(100.0, on_ring=True, tilt_sigma_deg=6.0, nadir=True)
NEAR = PhotoPrior(30.0)
DRAWS_AT_TAKEOFF = 12
"""Priors of each kind that the photograph at take-off is shown with."""


def drone_urban(folder: Path, prior: PhotoPrior = TILT_KNOWN, seed: int = 1, draws: int = 1) -> Path:
    """Cases of the 35 photographs, each with so many priors, and one of the photograph at take-off, which has no answer.

    `h` is metres above the streets.
    """
    rng, photos = np.random.default_rng(seed), _photos()
    folder.mkdir(parents=True, exist_ok=True)
    cases, truths = [], []
    for draw in range(draws):
        for photo in photos:
            case, truth = _case(photo, prior, rng, f"{Path(photo['file']).stem}_{draw}")
            cases.append(case)
            truths.append(truth)
    case, truth = _takeoff(photos[0], prior, rng, str(TAKEOFF["id"]))
    _write(folder / "cases.csv", [*cases, case])
    _write(folder / "truth.csv", [*truths, truth])
    return folder


def takeoff(folder: Path) -> Path:
    """The photograph at take-off with the heights, headings and tilts of others as its prior, place and tilt known variously."""
    folder.mkdir(parents=True, exist_ok=True)
    photos, cases, truths = _photos(), [], []
    for name, prior in (("known", TILT_KNOWN), ("unknown", TILT_UNKNOWN), ("near", NEAR)):
        for draw in range(DRAWS_AT_TAKEOFF):
            case, truth = _takeoff(photos[2 * draw], prior, np.random.default_rng(draw), f"{TAKEOFF['id']}_{name}_{draw}")
            cases.append(case)
            truths.append(truth)
    _write(folder / "cases.csv", cases)
    _write(folder / "truth.csv", truths)
    return folder


def _photos() -> list[dict[str, str]]:
    with (DATA / "photos.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _case(
    photo: dict[str, str], prior: PhotoPrior, rng: np.random.Generator, name: str
) -> tuple[dict[str, object], dict[str, object]]:
    """Row of cases.csv and of truth.csv of a photograph.

    Its table counts the lean of the optical axis to the right as positive roll; a body that rolls right leans it to the left.
    """
    lat, lon, h = float(photo["lat_deg"]), float(photo["lon_deg"]), float(photo["h_agl_m"])
    roll, pitch, yaw = -float(photo["roll_deg"]), 90 + float(photo["pitch_deg"]), float(photo["yaw_deg"])
    direction = rng.uniform(0, 2 * math.pi)
    off_m = prior.radius_m * (1.0 if prior.on_ring else math.sqrt(rng.uniform()))
    tilt = np.zeros(2) if prior.nadir else np.array([roll, pitch]) + rng.normal(0, prior.tilt_sigma_deg, 2)
    case: dict[str, object] = dict.fromkeys(COLUMNS, "") | {
        "id": name,
        "frame": str(DATA / photo["file"]),
        "ortho": str(DATA / "map.tif"),
        **{k: photo[k] for k in ("fx_px", "fy_px", "cx_px", "cy_px")},
        "prior_lat_deg": lat + off_m * math.cos(direction) / M_PER_DEG_LAT,
        "prior_lon_deg": lon + off_m * math.sin(direction) / (M_PER_DEG_LON * math.cos(math.radians(lat))),
        "prior_h_m": h * (1 + rng.uniform(-prior.h_share, prior.h_share)),
        "prior_roll_deg": tilt[0],
        "prior_pitch_deg": tilt[1],
        "prior_yaw_deg": yaw + rng.uniform(-prior.yaw_deg, prior.yaw_deg),
        "sigma_horizontal_m": prior.radius_m / 3**0.5,
        "sigma_h_m": prior.h_share * h / 3**0.5,
        "sigma_yaw_deg": prior.yaw_deg / 3**0.5,
        "sigma_tilt_deg": prior.tilt_sigma_deg,
    }
    pose = {"lat_deg": lat, "lon_deg": lon, "h_m": h, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
    return case, {"id": name, **pose, "gsd_m": 1.0, "solvable": 1}


def _takeoff(
    photo: dict[str, str], prior: PhotoPrior, rng: np.random.Generator, name: str
) -> tuple[dict[str, object], dict[str, object]]:
    """The photograph at take-off with the prior of another's height: nothing on the map looks like it."""
    lifted = photo | {k: str(v) for k, v in TAKEOFF.items() if k in photo} | {"file": "extra/takeoff_5m.jpg"}
    case, truth = _case(lifted, prior, rng, name)
    return case, truth | {"h_m": TAKEOFF["h_m"], "solvable": 0}


def _write(path: Path, table: list[dict[str, object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, table[0].keys())
        writer.writeheader()
        writer.writerows(table)
