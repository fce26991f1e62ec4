"""From what is known of a match to a calibrated probability that it is wrong, and to the reason where it is declined."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from visloc_companion.errors import Reason
from visloc_companion.localise.terrain.base import Kind
from visloc_companion.localise.terrain.settings import TerrainSettings

RIGHT_M = 20.0
RIGHT_SIGMAS = 4.0
"""A match is wrong if it is off by more than both: neither near, nor as far as it says that it may be."""
WEIGHTS = (1.99, 0.0559, -0.949, 0.825, 1.8, -0.625, -0.245, -0.231, 2.39)
"""Of `Evidence.regressors`, by `python -m benchmarks.terrain_fit --every 8`."""
MAX_SIGMAS = 4.5
MIN_SOUNDINGS = 30
MANY_OTHERS = 0.01
"""Posterior mass of other places from which a refusal is for ambiguity."""
MIN_RELIABILITY = 0.2
COUNTED_ALIKE = {Kind.PROFILE: 1.3, Kind.PATCH: 2.5}
"""So many times the worst 1-sigma of a fix may be what a match claims where soundings count alike: of 30 single beams that were
refused at once that (training seeds 501 to 504) 22 of the 23 below 1.3 times were within 20 m, and 5 of the 7 beyond; of 25
patches over even ground that claim up to 10 m (training seeds 801 to 805, fractal) all were within 20 m, at up to 2.5 times."""
MIN_GAIN = 5.0
"""Log-likelihood (of independent soundings) that the model must explain beyond level ground."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """`others`: posterior mass of all other places; `sigma_m`: worst 1-sigma where soundings count alike; `gain`: log-likelihood
    beyond that of level ground; `reliability`: share of the model's slopes that the soundings confirm; `sigma_ratio`: residuals'
    sigma over the expected; `ground`: share of soundings that are ground; `independent`: independent soundings;
    `position_sigmas`, `height_sigmas`: distance from the prior; `known`: share of soundings on known model; `converged`: 1 where
    the refinement did."""

    others: float
    sigma_m: float
    gain: float
    reliability: float
    sigma_ratio: float
    ground: float
    independent: float
    position_sigmas: float
    height_sigmas: float
    known: float
    converged: float

    def numbers(self) -> tuple[tuple[str, float], ...]:
        """As a fix or refusal reports it."""
        return tuple((name, float(value)) for name, value in asdict(self).items())

    def regressors(self) -> tuple[float, ...]:
        """What the logistic regression of being right is on."""
        others = min(max(self.others, 1e-6), 1 - 1e-6)
        return (
            1.0,
            math.log((1 - others) / others),
            math.log(max(self.sigma_m, 0.3)),
            math.log(max(self.gain, 0.1)),
            min(max(self.reliability, 0.0), 1.2),
            math.log(max(self.independent, 1.0)),
            min(self.position_sigmas, 6.0) ** 2,
            self.sigma_ratio**2,
            self.ground,
        )


def probability_wrong(evidence: Evidence) -> float:
    """Calibrated probability that the match is another place; no less than what the posterior gives the other places."""
    logit = sum(w * v for w, v in zip(WEIGHTS, evidence.regressors(), strict=True))
    return max(1 / (1 + math.exp(min(50.0, max(-50.0, logit)))), evidence.others)


def refusal(evidence: Evidence, p: float, claimed_m: float, kind: Kind, settings: TerrainSettings) -> tuple[Reason, str] | None:
    """Why a match that claims a worst 1-sigma is declined, or None."""
    e = evidence
    uneven = max(claimed_m, e.sigma_m / COUNTED_ALIKE[kind])
    reasons = (
        (e.gain < MIN_GAIN, Reason.LOW_TEXTURE, f"level ground explains the soundings as well (gain {e.gain:.1f})"),
        (e.reliability < MIN_RELIABILITY, Reason.LOW_TEXTURE, f"{100 * e.reliability:.0f} % of the model's slopes are confirmed"),
        (uneven > settings.max_sigma_m, Reason.LOW_TEXTURE, f"the ground is too even: 1-sigma {uneven:.0f} m"),
        (
            max(e.position_sigmas, e.height_sigmas) > MAX_SIGMAS,
            Reason.INCONSISTENT_WITH_PRIOR,
            f"{e.position_sigmas:.1f} sigma from the prior's place, {e.height_sigmas:.1f} from its height",
        ),
        (e.converged < 1, Reason.REFINEMENT_DIVERGED, "the refinement did not settle"),
        (p > settings.max_probability_wrong and e.others > MANY_OTHERS, Reason.AMBIGUOUS, f"{100 * e.others:.0f} % elsewhere"),
        (p > settings.max_probability_wrong, Reason.NO_MATCH, f"probability of being wrong {p:.3f}"),
    )
    return next(((reason, detail) for applies, reason, detail in reasons if applies), None)
