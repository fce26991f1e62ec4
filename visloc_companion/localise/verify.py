"""From the evidence of a match to a calibrated probability that it is wrong, and to the reason where it is declined.

An answer is wrong where it is another place, or where the place is right and the position far off all the same: what is not
known of the tilt moves the camera by the height times its tangent. The first is a logistic regression, the second follows from
the claimed covariance and the prior's. The regression was fitted where many places were searched. Where the prior leaves few,
chance has as many times fewer to be taken in by, and the odds of another place are smaller by that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

from visloc_companion.errors import Reason

CHANCE = 0.0744
"""Share of blocks that agree by chance: area of the agreement circle over that of the block search (blocks.py)."""
Weights = tuple[float, ...]
GRADIENT_WEIGHTS: Weights = (-1.79, 18.6, 5.48, 0.442, 2.6, -0.583, -1.95, -0.393, -1.14, 3.81, 0.0932, 0.115, 2.33)
"""Logistic regression of being right on `Evidence.regressors` (`python -m benchmarks.calibrate`, training rows only) for gradient
features, fitted without the shares of other places and single blocks, and ..."""
DEEP_WEIGHTS: Weights = (-1.52, 0.907, -4.49, 0.145, 0.626, 4.95, -1.45, -0.408, 10.3, -1.5, 0.0421, 0.224, 0.635)
"""... for the network's, and ..."""
AGAIN_WEIGHTS: Weights = (-2.4, 4.05, -8.39, 1.11, 0.57, 9.67, -0.294, -0.239, 1.89, -5.27, 0.0454, 0.204, 3.95)
"""... for a second look through the network's at what the first one declines (looks.py)."""
QUARTER_WEIGHTS: Weights = (-0.951, 0.782, 0.369)
"""... on `quarter_regressors`, for a first look that was declined and asked for its quarters (quarters.py), and ..."""
MOST_BY_QUARTERS, MOST_BEFORE = 20.0, 7.0
"""Greatest log-odds (nats) that count of the quarters, and of a match before they are asked; the latter against it, too."""
UNKNOWN_ATTITUDE_WEIGHTS: Weights = (1.96, 7.55, 1.64, 1.0, -1.49, -4.97)
"""... for frames of unknown attitude (`python -m benchmarks.cross_view --fit`, training rows only)."""
SURE_BLOCK_Z = 3.0
"""Agreeing blocks of the fine level beyond chance, in its standard deviations, from which quarters tell that there is no other
place. Along a shore that has moved quarters show the same wrong place, and those blocks do not."""
FAR_PX = 7.0
"""Pixels of the search level (90 across a footprint, fewer where the map has no more): an answer that is off by more is wrong
though the place be right. Of 150 training cases of unknown tilt 67 were accepted with 6 (none off by more than 10 px of the map),
83 with 7 (one), 114 with 10 (ten)."""
FITTED_PLACES = 300.0
"""Fewest places (pixels of the search within 3 sigmas of the prior) of a case on which the weights were fitted: woods, known to
4 m. The others had 1,000 and more."""
SEARCHED_SIGMAS = 3.0
FARTHEST, MOST_TERMS = 10.0, 150
"""Sigmas that Rice's distribution is worked out for, and terms of its sum: with these it is right to a millionth."""
MAX_CHI2_SIGMA = 4.5
MIN_SCORE = 0.12
AMBIGUOUS_RATIO = 0.93


REPORTED_AS = {"agreeing": "blocks_agreeing", "scatter": "scatter_px"}


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of the best match.

    `score`: correlation after refinement, `coarse_score`: at the search level; `runner_up`: best other place's score there over
    the best's; `lead`: log-odds against the other candidates (ranking.py), `mode_mass`:
    probability of its place by the search's posterior; `blocks`, `agreeing`: blocks matched on their own
    and how many agree; `footprint_px`: side of the footprint; `scatter`: of the blocks about the pose, pixels;
    `height_sigmas`, `yaw_sigmas`, `position_sigmas`, `tilt_sigmas`: distance from the prior; `returning`: share of blocks that
    agree from frame to map and back; `sigma_px`: claimed 1-sigma along the worst horizontal axis, pixels of the search;
    `prior_px`: the prior's, in the mean of both axes, as it is searched (infinite where nobody says).
    """

    score: float
    coarse_score: float
    runner_up: float
    lead: float
    mode_mass: float
    blocks: float
    agreeing: float
    footprint_px: float
    scatter: float
    height_sigmas: float
    yaw_sigmas: float
    position_sigmas: float
    tilt_sigmas: float
    returning: float
    sigma_px: float
    prior_px: float = math.inf

    @classmethod
    def from_numbers(cls, numbers: Mapping[str, float]) -> Evidence:
        """From what a fix or refusal reports (`numbers`)."""
        reported = {f.name: REPORTED_AS.get(f.name, f.name) for f in fields(cls)}
        return cls(**{name: numbers[of] for name, of in reported.items() if of in numbers})

    def numbers(self) -> dict[str, float]:
        """As a fix or refusal reports it."""
        return {REPORTED_AS.get(name, name): float(value) for name, value in asdict(self).items()}

    def regressors(self) -> tuple[float, ...]:
        """What the logistic regression is on."""
        z = math.sqrt(max(0.0, block_z(self.blocks, self.agreeing)))
        size = math.log(self.footprint_px / 173)
        spread = math.log(0.3 + self.scatter)
        away = min(self.position_sigmas, 5.0) ** 2
        outside = max(1 - self.mode_mass, 1e-4)
        mass = math.log(max(self.mode_mass, 1e-4) / outside)
        coarse = self.coarse_score, self.coarse_score * size
        return (
            1.0,
            self.score,
            self.score * size,
            z,
            1 - self.runner_up,
            size,
            spread,
            away,
            *coarse,
            self.lead,
            mass,
            self.returning,
        )


def block_z(blocks: float, agreeing: float) -> float:
    """Agreeing blocks beyond chance, in standard deviations of chance."""
    return (agreeing - CHANCE * blocks) / math.sqrt(max(blocks, 1) * CHANCE * (1 - CHANCE))


def probability_wrong(evidence: Evidence, weights: Weights, quarters: float | None = None) -> float:
    """Calibrated probability that the match is another place, or is this place and far off; `quarters`: nats by which the frame's
    speak for it (quarters.py), where they were asked."""
    place = probability_of_place(evidence, weights)
    if quarters is not None:
        place = logistic(log_odds(QUARTER_WEIGHTS, quarter_regressors(place, quarters)))
    return 1 - place * near_enough(evidence)


def probability_of_place(evidence: Evidence, weights: Weights) -> float:
    """Calibrated probability that the match is of the right place."""
    return logistic(log_odds(weights, evidence.regressors()) + fewer_places(evidence.prior_px))


def near_enough(evidence: Evidence) -> float:
    """Probability that a match of the right place is not far off."""
    return probability_near(evidence.sigma_px, evidence.prior_px, evidence.position_sigmas)


def fewer_places(prior_px: float) -> float:
    """Nats by which a prior of this 1-sigma leaves fewer places than the weights were fitted with."""
    return max(0.0, math.log(FITTED_PLACES / math.pi) - 2 * math.log(SEARCHED_SIGMAS * max(prior_px, 1e-3)))


def log_odds(weights: Weights, regressors: tuple[float, ...]) -> float:
    """Of being right, by a logistic regression."""
    return sum(w * v for w, v in zip(weights, regressors, strict=True))


def logistic(log_odds: float) -> float:
    """The probability of odds with this logarithm, which beyond ±50 makes no difference."""
    return 1 / (1 + math.exp(min(50.0, max(-50.0, -log_odds))))


def probability_near(sigma_px: float, prior_px: float = math.inf, position_sigmas: float = 0.0) -> float:
    """Probability that a position of this 1-sigma on each axis, so many of the prior's sigmas from the prior, is not far off.

    By both it is off by some of the way to the prior, and scatters about that by less than its sigma.
    """
    if math.isinf(prior_px):
        return within(FAR_PX / max(sigma_px, 1e-3), 0.0)
    towards_prior = sigma_px**2 / max(sigma_px**2 + prior_px**2, 1e-9)
    scatter_px = max(sigma_px * math.sqrt(1 - towards_prior), 1e-3)
    return within(FAR_PX / scatter_px, min(towards_prior * position_sigmas * prior_px / scatter_px, FARTHEST))


def within(radius: float, off: float) -> float:
    """Probability that a point lies in a circle of a radius, which is so far from its middle on average and scatters by 1 on each
    axis (Rice's distribution, as a mixture of chi-squared ones)."""
    a, b = off * off / 2, radius * radius / 2
    share, term, inside = math.exp(-a), math.exp(-b), 0.0
    beyond = term
    for k in range(1, MOST_TERMS):
        inside += share * (1 - beyond)
        share, term = share * a / k, term * b / k
        beyond += term
    return inside


def unknown_attitude_regressors(numbers: Mapping[str, float]) -> tuple[float, ...]:
    """What being right is regressed on where the attitude was searched for, too (cross_view.py). `ahead`: score less that of what
    resembles the frame elsewhere."""
    z = math.sqrt(max(0.0, block_z(numbers["blocks"], numbers["blocks_agreeing"])))
    spread, sigma = math.log(0.3 + numbers["scatter_px"]), math.log(max(numbers["sigma_px"], 1e-3))
    return 1.0, numbers["score"], numbers["ahead"], z, spread, sigma


def unknown_attitude_wrong(numbers: Mapping[str, float]) -> float:
    """Calibrated probability that such an answer is another place, or is this place and far off, from its evidence."""
    return logistic(-log_odds(UNKNOWN_ATTITUDE_WEIGHTS, unknown_attitude_regressors(numbers)))


def beside_others(alone: float, share: float) -> float:
    """Probability that a match is wrong which is so with `alone` by its own looks, and has a share of all places that may be it.

    The looks were fitted where few places look alike; over ground that repeats itself they claim 0.003 and are wrong as often as
    not.
    """
    return 1 - (1 - alone) * share


def or_by_quarters(left: float, evidence: Evidence, quarters: float | None) -> float:
    """What others leave of a match's place (`left`: other places, or these and single blocks), or what the frame's quarters
    (nats) leave of it where they were asked, many blocks of the fine level agree, and that is more.

    Candidates that were refined to places a few pixels apart are each other's rivals, and one place to the quarters.
    """
    if quarters is None or block_z(evidence.blocks, evidence.agreeing) < SURE_BLOCK_Z:
        return left
    return max(left, logistic(quarters))


def left_to_place(numbers: Mapping[str, float]) -> float:
    """What other places and single blocks, or the quarters, leave of a match, from what a fix or refusal reports."""
    return or_by_quarters(numbers["share"] * numbers["votes"], Evidence.from_numbers(numbers), numbers.get("quarters"))


def quarter_regressors(place: float, quarters: float) -> tuple[float, ...]:
    """What being the right place is regressed on where a frame's quarters were asked: its log-odds by the match's own looks,
    and by the quarters."""
    odds = math.log(max(place, 1e-9) / max(1 - place, 1e-9))
    return 1.0, min(max(odds, -MOST_BEFORE), MOST_BEFORE), min(max(quarters, -MOST_BEFORE), MOST_BY_QUARTERS)


def crowded(p: float, share: float, max_probability_wrong: float) -> tuple[Reason, str] | None:
    """Why a match of a share (`beside_others`) is declined that is wrong with p because of the others, or None."""
    if p <= max_probability_wrong:
        return None
    return Reason.AMBIGUOUS, f"one of several places, {100 * (1 - share):.0f} % for the others"


def outvoted(p: float, votes: float, max_probability_wrong: float) -> tuple[Reason, str] | None:
    """Why a match is declined that is wrong with p because the blocks of the frame, each by itself, give it no larger share
    (block_votes.py), or None."""
    if p <= max_probability_wrong:
        return None
    return Reason.BLOCKS_DISAGREE, f"one structure or another place, {100 * (1 - votes):.0f} % by what single blocks show"


def refusal(evidence: Evidence, p: float, max_probability_wrong: float) -> tuple[Reason, str] | None:
    """Why the match is declined, or None."""
    worst = max(evidence.height_sigmas, evidence.yaw_sigmas, evidence.position_sigmas, evidence.tilt_sigmas)
    if worst > MAX_CHI2_SIGMA:
        return Reason.INCONSISTENT_WITH_PRIOR, f"{worst:.1f} sigma from the prior"
    if p <= max_probability_wrong:
        return None
    detail = f"probability of being wrong {p:.3f}, sigma {evidence.sigma_px:.1f} px"
    if evidence.score < MIN_SCORE:
        return Reason.NO_MATCH, detail
    if evidence.runner_up > AMBIGUOUS_RATIO:
        return Reason.AMBIGUOUS, detail
    if block_z(evidence.blocks, evidence.agreeing) < 4:
        return Reason.BLOCKS_DISAGREE, detail
    return Reason.NO_MATCH, detail
