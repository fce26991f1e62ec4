"""Folders of image cases: `cases.csv` and, where there is one, `truth.csv` (format: `visloc evaluate image --help`, docs)."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.adapters.table import number_in
from visloc_companion.errors import CasesError
from visloc_companion.evaluate.case_ids import require_distinct
from visloc_companion.evaluate.number_list import number_texts
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import DISTORTION_COEFFICIENTS, CameraModel, DistortionModel, GeoPoint, Image, PosePrior

COLUMNS = (
    *("id", "frame", "ortho", "dsm", "fx_px", "fy_px", "cx_px", "cy_px", "distortion"),
    *("prior_lat_deg", "prior_lon_deg", "prior_h_m", "prior_roll_deg", "prior_pitch_deg", "prior_yaw_deg"),
    *("sigma_horizontal_m", "sigma_h_m", "sigma_yaw_deg", "sigma_tilt_deg"),
)
TRUTH_NEEDED = ("id", "lat_deg", "lon_deg")
TRUTH_COLUMNS = (*TRUTH_NEEDED, "h_m", "roll_deg", "pitch_deg", "yaw_deg")
LARGEST = 1e9
"""No number of a case is larger, in whatever unit; squares of larger ones leave the range of numbers."""
LEAST_FOCAL_PX = 1.0
"""No lens shows all that is before it on less than some pixels."""
EULER_COLUMNS = ("prior_roll_deg", "prior_pitch_deg", "prior_yaw_deg")

BEYOND = "\0"
"""Stands for the column of what a row has more than columns: no file has one of that name."""
SOLVABLE = {"0": False, "false": False, "1": True, "true": True}


@dataclass(frozen=True, slots=True)
class Camera:
    """Calibration of a case; the size comes with the frame, where `size_px` (width and height) does not say whose it is."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...]
    distortion_model: DistortionModel = "brown_conrady"
    size_px: tuple[int, int] | None = None

    def model(self, frame: Image) -> CameraModel:
        """The camera model of a frame of this size."""
        height, width = frame.shape[:2]
        return CameraModel(width, height, self.fx_px, self.fy_px, self.cx_px, self.cy_px, self.distortion, self.distortion_model)


@dataclass(frozen=True, slots=True)
class Case:
    """One frame to be placed on one map; `mask` tells what of the frame is ground (adapters/camera/mask.py)."""

    case_id: str
    frame: Path
    ortho: Path
    dsm: Path | None
    camera: Camera
    prior: PosePrior
    mask: Path | None = None


@dataclass(frozen=True, slots=True)
class BadCase:
    """A row that cannot be understood."""

    case_id: str
    why: str


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the camera was; height and angles are NaN where the table does not say. `gsd_m` (of the map) and `solvable` are 0 and
    True where it does not.

    `map_date` and `frame_date` are as the table writes them (YYYYMMDD where they are known), else empty.
    """

    lat_deg: float
    lon_deg: float
    h_m: float
    yaw_deg: float
    gsd_m: float
    solvable: bool
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    map_date: str = ""
    frame_date: str = ""

    @property
    def is_pose(self) -> bool:
        """Whether height and attitude are known, too."""
        return all(map(math.isfinite, (self.h_m, self.roll_deg, self.pitch_deg, self.yaw_deg)))


def read_cases(folder: Path) -> list[Case | BadCase]:
    """The rows of `cases.csv`. Raises CasesError where the file or one of its columns is missing, or ids are not distinct."""
    path = folder / "cases.csv"
    cases = [_case(folder, row, k) for k, row in enumerate(_table(path, COLUMNS))]
    require_distinct([case.case_id for case in cases], path)
    return cases


def read_by(folder: Path) -> set[Path]:
    """The frames, maps and masks that cases name; a map may be a folder. Raises CasesError as `read_cases`."""
    cases = [case for case in read_cases(folder) if isinstance(case, Case)]
    return {file for case in cases for file in (case.frame, case.ortho, case.dsm, case.mask) if file is not None}


def read_truth(folder: Path) -> dict[str, Truth]:
    """Truth by case id; empty where there is no `truth.csv`. Raises CasesError for one that cannot be read."""
    path = folder / "truth.csv"
    if not path.exists():
        return {}
    rows = _table(path, TRUTH_NEEDED)
    require_distinct([row["id"] for row in rows], path)
    truth: dict[str, Truth] = {}
    for number, row in enumerate(rows, start=1):
        try:
            truth[row["id"]] = _truth(row)
        except ValueError as why:
            raise CasesError(str(why), where=f"{path}, row {number}", remedy="correct the value") from why
    return truth


def read_frame(path: Path) -> Image | None:
    """The frame as RGB or grey uint8; None where there is no readable image."""
    try:
        return decode_image(path.read_bytes(), keep_grey=True)
    except OSError:
        return None


def _table(path: Path, columns: tuple[str, ...]) -> list[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, skipinitialspace=True)
            names = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = names
            missing = [c for c in columns if c not in names]
            rows = [row for row in map(_row, reader) if any(text.strip() for text in row.values())]
    except OSError as why:
        raise CasesError(f"cannot be read: {why}", where=str(path), remedy="name a folder with cases.csv") from why
    except (UnicodeDecodeError, csv.Error) as why:
        raise CasesError(f"cannot be read: {why}", where=str(path), remedy="write UTF-8 CSV, separated by commas") from why
    if missing:
        remedy = "add them" if len(missing) < len(columns) else "separate them by commas, and name them in the first line"
        raise CasesError(f"columns are missing: {', '.join(missing)}", where=str(path), remedy=remedy)
    if twice := sorted({name for name in names if name and names.count(name) > 1}):
        raise CasesError(f"has column {', '.join(twice)} more than once", where=str(path), remedy="leave one of them there")
    return rows


def _row(row: dict[str | None, Any]) -> dict[str, str]:
    """A row's fields without blanks behind them (but the id, which is given back as it is); what it has beyond the columns, other
    than blanks, under `BEYOND`."""
    beyond = ", ".join(text for text in row.pop(None, None) or () if text.strip())
    fields = {str(column): (text or "") if column == "id" else (text or "").rstrip() for column, text in row.items()}
    return fields | ({BEYOND: beyond} if beyond else {})


def _require_no_more(row: dict[str, str]) -> None:
    if BEYOND in row:
        raise ValueError(
            f"has more fields than there are columns ({row[BEYOND]!r}): write decimals with a point, quote texts with commas"
        )


def _case(folder: Path, row: dict[str, str], number: int) -> Case | BadCase:
    case_id = row["id"] or f"row{number + 1}"
    try:
        _require_no_more(row)
        return Case(
            case_id,
            folder / _named(row, "frame"),
            folder / _named(row, "ortho"),
            folder / _named(row, "dsm") if row["dsm"] else None,
            _camera(row),
            _prior(row),
            folder / _named(row, "mask") if row.get("mask") else None,
        )
    except ValueError as why:
        return BadCase(case_id, str(why))


def _prior(row: dict[str, str]) -> PosePrior:
    place = GeoPoint(_number(row, "prior_lat_deg"), _number(row, "prior_lon_deg"), _number(row, "prior_h_m"))
    if not (-90 <= place.lat_deg <= 90 and -360 <= place.lon_deg <= 360):
        raise ValueError(f"prior is not on earth: {place.lat_deg}, {place.lon_deg}")
    roll, pitch, yaw = (math.radians(_number(row, c)) for c in EULER_COLUMNS)
    variance = _sigma(row, "sigma_horizontal_m") ** 2
    return PosePrior(
        place,
        quat_from_euler(roll, pitch, yaw),
        ((variance, 0.0), (0.0, variance)),
        _sigma(row, "sigma_h_m"),
        math.radians(_sigma(row, "sigma_yaw_deg")),
        math.radians(_sigma(row, "sigma_tilt_deg")),
    )


def _camera(row: dict[str, str]) -> Camera:
    fx, fy, cx, cy = (_number(row, c) for c in ("fx_px", "fy_px", "cx_px", "cy_px"))
    if min(fx, fy) <= 0:
        raise ValueError(f"focal length is not positive: {fx}, {fy}")
    if min(fx, fy) < LEAST_FOCAL_PX:
        raise ValueError(f"fx_px and fy_px are no lens's: {fx}, {fy} (write pixels)")
    name = row.get("distortion_model") or "brown_conrady"
    models = {str(model): model for model in DISTORTION_COEFFICIENTS}
    if name not in models:
        raise ValueError(f"distortion_model is none of {', '.join(models)}: {name!r}")
    return Camera(fx, fy, cx, cy, _distortion(row["distortion"], models[name]), models[name], _size_px(row))


def _size_px(row: dict[str, str]) -> tuple[int, int] | None:
    """What the calibration is for; the columns may be missing or empty."""
    if not (row.get("width_px") or row.get("height_px")):
        return None
    width, height = (_number({c: row.get(c) or ""}, c) for c in ("width_px", "height_px"))
    if min(width, height) < 1 or width % 1 or height % 1:
        raise ValueError(f"width_px and height_px are no size: {width:g} x {height:g}")
    return int(width), int(height)


def _truth(row: dict[str, str]) -> Truth:
    _require_no_more(row)
    lat, lon = (_number(row, c) for c in ("lat_deg", "lon_deg"))
    h, yaw, roll, pitch = (_number(row, c) if row.get(c) else math.nan for c in ("h_m", "yaw_deg", "roll_deg", "pitch_deg"))
    if not (abs(lat) <= 90 and abs(lon) <= 360):
        raise ValueError(f"truth is not on earth: {lat}, {lon}")
    gsd_m, solvable = _number({"gsd_m": row.get("gsd_m") or "0"}, "gsd_m"), (row.get("solvable") or "1").lower()
    if solvable not in SOLVABLE:
        raise ValueError(f"solvable is neither 0 nor 1: {solvable!r}")
    return Truth(lat, lon, h, yaw, gsd_m, SOLVABLE[solvable], roll, pitch, row.get("map_date") or "", row.get("frame_date") or "")


def _named(row: dict[str, str], column: str) -> str:
    if not row[column] or "\0" in row[column]:
        raise ValueError(f"{column} is empty" if not row[column] else f"{column} names no file: {row[column]!r}")
    return row[column]


def _number(row: dict[str, str], column: str) -> float:
    try:
        value = number_in(row[column])
    except ValueError:
        remedy = " (write decimals with a point)" if "," in row[column] else ""
        raise ValueError(f"{column} is not a number: {row[column]!r}{remedy}") from None
    if not math.isfinite(value):
        raise ValueError(f"{column} is not finite: {row[column]!r}")
    if abs(value) > LARGEST:
        raise ValueError(f"{column} is too large: {value}")
    return value


def _sigma(row: dict[str, str], column: str) -> float:
    value = _number(row, column)
    if value < 0:
        raise ValueError(f"{column} is negative: {value}")
    return value


def _distortion(text: str, model: DistortionModel) -> tuple[float, ...]:
    """The coefficients; of a Brown-Conrady lens those that are left out at the end are zero."""
    values = tuple(_number({"distortion": x}, "distortion") for x in number_texts(text))
    names = DISTORTION_COEFFICIENTS[model]
    if model == "brown_conrady" and len(values) <= len(names):
        return values + (0.0,) * (len(names) - len(values))
    if len(values) != len(names):
        most = "at most " if model == "brown_conrady" else ""
        raise ValueError(f"distortion has {len(values)} coefficients, expected {most}{len(names)}: {' '.join(names)}")
    return values
