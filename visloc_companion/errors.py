"""The tree of exceptions and the one enumeration of reasons.

"No" is a value (`types.NoFix`, `types.Rejected`) that carries a `Reason`; "broken" is an exception of this tree:

    VislocError
    ├── ConfigError
    ├── MapError ── OutsideMap, DatumMissing, HashMismatch, SignatureInvalid, CloudError
    ├── ModelError
    ├── LinkError
    ├── CameraError ── PictureSizeError
    ├── WorkerError
    ├── JournalError
    ├── LogError
    └── CasesError
"""

import difflib
import errno
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path


class VislocError(Exception):
    """Base of everything this package raises on purpose.

    `where` names the file (and the field in it), `remedy` says what the user can do; both are part of the text.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        parts = [f"{where}: {what}" if where else what]
        if remedy:
            parts.append(f"remedy: {remedy}")
        super().__init__("; ".join(parts))

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.what, self.where, self.remedy))


def _rebuild(kind: type[VislocError], what: str, where: str, remedy: str) -> VislocError:
    return kind(what, where=where, remedy=remedy)


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """The nearest of the valid names, capitals or not, as a question for a message; empty where none is near."""
    folded = {one.casefold(): one for one in valid}
    near = difflib.get_close_matches(name.casefold(), list(folded), n=1, cutoff=0.5)
    return f"did you mean {folded[near[0]]!r}?" if near else ""


def fault_text(fault: BaseException) -> str:
    """An exception that nobody raised on purpose, in one line: kind, text, file and line."""
    calls = traceback.extract_tb(fault.__traceback__)
    where = f" ({Path(calls[-1].filename).name}:{calls[-1].lineno})" if calls else ""
    return f"{type(fault).__name__}: {fault}{where}"


_OF_THE_DISK = frozenset((errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO))


def is_of_the_disk(fault: BaseException | None) -> bool:
    """Whether a disk is full, fails, or was made read-only for its errors: no fault of the configuration."""
    return isinstance(fault, OSError) and fault.errno in _OF_THE_DISK


class ConfigError(VislocError):
    """The configuration is wrong: unknown key, bad value, or parts that contradict each other."""


@contextmanager
def stated_in(file: Path) -> Iterator[None]:
    """Put before the key that a ConfigError names the file that states it, for those who read several."""
    try:
        yield
    except ConfigError as why:
        raise ConfigError(why.what, where=f"{file}: {why.where}" if why.where else str(file), remedy=why.remedy) from why


class MapError(VislocError):
    """A map pack or raster cannot be used."""


class OutsideMap(MapError):
    """The asked place lies wholly outside the map."""


class DatumMissing(MapError):
    """A height or coordinate system is needed that the map does not state."""


class HashMismatch(MapError):
    """A file of the pack is not the one that its manifest names."""


class SignatureInvalid(MapError):
    """The signature of the pack does not fit its manifest."""


class CloudError(MapError):
    """A point cloud cannot be used."""


class ModelError(VislocError):
    """A network file is missing, changed, or answers wrong."""


class LinkError(VislocError):
    """The MAVLink connection cannot be opened or used."""


class CameraError(VislocError):
    """The camera or its calibration cannot be used."""


class PictureSizeError(CameraError):
    """Frames of another size than the calibration's."""


class WorkerError(VislocError):
    """The localisation worker failed in a way that a restart does not mend."""


class JournalError(VislocError):
    """The journal cannot be written or read."""


class LogError(VislocError):
    """A recorded flight cannot be read."""


class CasesError(VislocError):
    """A folder of evaluation cases cannot be read."""


class Reason(StrEnum):
    """Why there is no fix, why a fix was rejected, or why something was dropped. One list for logs, metrics and reports."""

    # the localiser has no answer
    OUTSIDE_MAP = "outside_map"
    LOW_TEXTURE = "low_texture"
    TOO_DARK = "too_dark"
    OVEREXPOSED = "overexposed"
    BLURRED = "blurred"
    NO_BASELINE = "no_baseline"
    NO_PARALLAX = "no_parallax"
    LOW_OVERLAP = "low_overlap"
    HORIZON_IN_VIEW = "horizon_in_view"
    TOO_LOW = "too_low"
    NO_MATCH = "no_match"
    AMBIGUOUS = "ambiguous"
    BLOCKS_DISAGREE = "blocks_disagree"
    INCONSISTENT_WITH_PRIOR = "inconsistent_with_prior"
    REFINEMENT_DIVERGED = "refinement_diverged"
    SEARCH_TOO_WIDE = "search_too_wide"
    TOO_FEW_FEATURES = "too_few_features"
    POSE_FAILED = "pose_failed"
    MOVING_SURFACE = "moving_surface"
    BAD_FRAME = "bad_frame"
    FROZEN = "frozen"
    BAD_INPUT = "bad_input"
    # the worker or the queue has no answer
    WORKER_TIMEOUT = "worker_timeout"
    WORKER_DIED = "worker_died"
    COMPUTATION_DIFFERS = "computation_differs"
    SWITCHED_OFF = "switched_off"
    SUPERSEDED = "superseded"
    # the navigator does not take it
    GATED = "gated"
    TOO_OLD = "too_old"
    NOT_FINITE = "not_finite"
    AT_A_POLE = "at_a_pole"
    IMPLAUSIBLE_CLAIM = "implausible_claim"
    NO_ORIGIN = "no_origin"
    NO_ATTITUDE = "no_attitude"
    NO_GIMBAL_ATTITUDE = "no_gimbal_attitude"
    GIMBAL_TURNING = "gimbal_turning"
    NOT_SEEDED = "not_seeded"
    IMPLAUSIBLE_TIME = "implausible_time"
