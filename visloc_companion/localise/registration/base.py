"""What every registration method is asked and what it answers. Colour plays no part: clouds are points in metres."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol

from visloc_companion.errors import Reason
from visloc_companion.types import FloatArray


@dataclass(frozen=True, slots=True)
class RegistrationPrior:
    """1-sigma of the source's place in the reference about the identity (a uniform ±a is given as a/√3: 3 sigma covers it).

    `sigma_scale` is relative, the angles are radians about the source's middle: `sigma_yaw_rad` about up, `sigma_tilt_rad` about
    each horizontal axis. `sigma_growth_m`: how much the surface may have risen since the reference was captured; it
    widens what is claimed of the height and what counts as a change, and moves nothing.
    `sigma_far_edge_m`: how much farther out edges that look away from the source's middle may lie than others, as in a cloud made
    from pictures taken there, which do not show the ground behind them; 0 for clouds that see all sides.
    `gaussian`: places, headings and scales are likelier the nearer they are to the prior's own, as a filter's are; otherwise all
    within 3 sigma are alike. Raises ValueError for a sigma that is negative or not a number.
    """

    sigma_horizontal_m: float
    sigma_vertical_m: float
    sigma_yaw_rad: float
    sigma_tilt_rad: float
    sigma_scale: float
    sigma_growth_m: float = 0.0
    gaussian: bool = False
    sigma_far_edge_m: float = 0.0

    def __post_init__(self) -> None:
        sigmas = [getattr(self, field.name) for field in fields(self) if field.name.startswith("sigma_")]
        if not all(sigma >= 0 for sigma in sigmas):
            raise ValueError(f"{self}: a sigma is negative or not a number")


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """`T_reference_source` (4, 4) similarity: p_reference = T [p_source, 1], metres; errors are of the source's middle.

    `covariance_m2` (3, 3) east, north, up of the reference's axes; `sigma_yaw_rad`, `sigma_scale` 1-sigma as well.
    `probability_wrong` is calibrated (off by more than 5 m horizontally), `evidence` what it was computed from.
    """

    T_reference_source: FloatArray
    covariance_m2: FloatArray
    sigma_yaw_rad: float
    sigma_scale: float
    probability_wrong: float
    evidence: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class NotRegistered:
    """The method declines: water, a flat field, several places alike, too few points."""

    reason: Reason
    detail: str
    evidence: tuple[tuple[str, float], ...] = ()


class RegistrationMethod(Protocol):
    """A method: pure and deterministic, one thread."""

    def __call__(self, source_m: FloatArray, reference_m: FloatArray, prior: RegistrationPrior) -> Registered | NotRegistered:
        """Register `source_m` (N, 3) to `reference_m` (M, 3), east, north, up in metres.

        Raises ValueError for arrays of another shape or with values that are not finite (readers refuse these with the file's
        name before).
        """
        ...
