"""Where all ground that has not changed would have a stereo cloud: asked where its relief as a whole leaves a doubt.

Of land much of which was felled, built or ploughed since, the correlation of a whole cloud is chance: at the right place it is
often the least. What has not changed tells in two ways, and each takes whatever has changed for any ground at all: blocks whose
relief still resembles the reference's (consensus.py), and cells whose slopes are still the reference's (lasting.py). Their
likelihoods are added up place by place, with the prior's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.localise.registration.claims import MOST_BOWL_M
from visloc_companion.localise.registration.consensus import beside
from visloc_companion.localise.registration.handicap import NATS, of_place, of_turn
from visloc_companion.localise.registration.headings import are_two
from visloc_companion.localise.registration.lasting import STEP_M, Lasting, Places
from visloc_companion.localise.registration.nearby import OWN_M
from visloc_companion.localise.registration.refine import ALIKE, TINY
from visloc_companion.localise.registration.search import APART_M, region
from visloc_companion.localise.registration.settle import Settled, Settler, has_slid
from visloc_companion.localise.registration.similarity import about, moved, scale_of, yaw_of
from visloc_companion.localise.registration.surfaces import surface_of
from visloc_companion.types import FloatArray

LIKELIEST = 4
"""Places that the slopes name."""
AROUND_M, STRIDE = 4.0, 2
"""A start is looked at so far about, every so many cells first."""
TURNS = (-0.5, -0.25, 0.25, 0.5)
"""Other headings and scales of the likeliest place, in steps (lasting.STEP_M) of the source's edge."""
ELSEWHERE_M, MOST_ELSEWHERE = 3.0, 12
"""How far apart other places of the region are looked at, and how many of these steps it is wide at most, or they are farther."""
CLEAR_LEAD, CLEAR_NATS, CLEAR_M = 0.1, 50.0, 0.45
"""There is no doubt of a place whose score leads the other candidates' by so much, that the blocks make so much likelier than
what is beside it (Evidence's `blocks_lead`), and that is held so well (1-sigma), unless the cloud would have to be bent much."""
SIGMA_M = 1.3
"""1-sigma, east and north, of a place that is not refined: cameras err by 1.2 m on an axis (rms) at 20 such places of seeds 60 to
67 and 150 to 159 of benchmarks/changed_land.py."""
WORTH = 0.17
"""Log-odds that a nat is worth: cells and blocks are not as independent as they are counted (fitted with structure/claims.py)."""
COARSE_NATS = 10.0
"""By so much more a place that is not refined has to be likelier than one that is."""


@dataclass(frozen=True, slots=True, eq=False)
class Likely:
    """A similarity (4, 4), and the nats of all that has not changed there, the prior's included."""

    T: FloatArray
    nats: float


def is_clear(best: Settled, candidates: Iterable[Settled], settler: Settler) -> bool:
    """Whether the score and the blocks leave no doubt of the best of the candidates."""
    others = (s.found.score for s in candidates if are_two(settler.pair, s.refined.T, best.refined.T))
    loose = float(np.linalg.eigvalsh(best.refined.placed[:2, :2])[-1]) > CLEAR_M**2
    if loose or abs(best.refined.bowl_m) > MOST_BOWL_M or best.found.score - max([0.0, *others]) < CLEAR_LEAD:
        return False
    return settler.of_blocks(best)[0] >= CLEAR_NATS


def placed_by_unchanged(
    best: Settled, starts: Iterable[FloatArray], settler: Settler
) -> tuple[Settled, tuple[float, FloatArray] | None]:
    """The likeliest place by all that has not changed, with its lead (nats) and (2, 2) what is alike beside it, east and north:
    as last steps have it from there or as the best of the candidates has it, else as it is. The best of the candidates without a
    lead where nothing is known of any."""
    unchanged = Unchanged(settler)
    likely = unchanged.likeliest(starts)
    held = settler.held([likely[0].T], SIGMA_M) if likely else []
    if not held:
        return best, None
    refined = [s for s in (best, settler.sharpened(held[0])) if s is not None and not has_slid(s, settler.pair)]
    sharper = [Likely(s.refined.T, unchanged.nats(s.refined.T)) for s in refined]
    merits = [likely[0].nats - COARSE_NATS]
    merits += [-np.inf if are_two(settler.pair, one.T, likely[0].T) else one.nats for one in sharper]
    chosen = [held[0], *refined][int(np.argmax(merits))]
    return chosen, (unchanged.lead([*likely, *sharper]), unchanged.alike_m2(chosen.refined.T))


class Unchanged:
    """What the ground that has not changed says of places of one pair."""

    def __init__(self, settler: Settler) -> None:
        self._cells, self._pair, self._prior = settler.cells, settler.pair, settler.prior
        self._lasting, self._relief = Lasting(settler.pair, settler.prior), surface_of(settler.pair.reference_relief)

    def likeliest(self, starts: Iterable[FloatArray]) -> list[Likely]:
        """The likeliest places about some starts (4, 4) and those that the slopes name, best first: the first of them at its
        likeliest heading and scale, too."""
        all_starts = [*starts, *self._lasting.starts(LIKELIEST)]
        found = sorted((self._peak(self._peak(T, AROUND_M, STRIDE).T) for T in all_starts), key=lambda one: -one.nats)
        return [self._turned(found[0]), *found[1:]] if found else []

    def nats(self, T: FloatArray) -> float:
        """Of where T (4, 4) puts the source."""
        return float(self._likely(T, 0.0, 1)[0].max())

    def lead(self, likely: Sequence[Likely]) -> float:
        """By how many nats the first is likelier than any other of those and of the prior's region, at its heading and scale; 0
        where there is no other."""
        best, low, high = likely[0], *region(self._pair, self._prior)
        here_m = moved(best.T, self._pair.centre_m)[:2]
        others = [one.nats for one in likely if np.hypot(*(moved(one.T, self._pair.centre_m)[:2] - here_m)) >= APART_M]
        half_m = self._pair.reference.cell_m * (high - low) / 2
        middle_m = self._pair.reference.corner_m + self._pair.reference.cell_m * ((low + high) / 2 + 0.5)
        middle = about(self._pair.centre_m, yaw_of(best.T), scale_of(best.T), np.append(middle_m - self._pair.centre_m[:2], 0.0))
        reach_m = float(half_m.max())
        step = round(max(ELSEWHERE_M, 2 * reach_m / MOST_ELSEWHERE) / self._pair.reference.cell_m)
        nats, at_m = self._likely(middle, reach_m, max(step, 1))
        away = (np.abs(at_m) <= half_m).all(-1) & (np.hypot(*np.moveaxis(at_m + middle_m - here_m, -1, 0)) >= APART_M)
        others += [float(nats[away].max())] if away.any() else []
        return best.nats - max(others) if others else 0.0

    def alike_m2(self, T: FloatArray) -> FloatArray:
        """(2, 2) east, north: second moment about T's place of what is as likely within APART_M but for the prior, as
        nearby.spread_m2."""
        nats, at_m = self._of_ground(T, APART_M, STRIDE)
        away = np.hypot(*np.moveaxis(at_m, -1, 0))[..., None]
        weight = np.where(away < APART_M, np.exp(WORTH * (nats - nats.max()))[..., None], 0.0)
        off = np.where(away > OWN_M, at_m, 0.0)
        return np.asarray(np.einsum("vui,vuj->ij", off * weight, off) / max(float(weight.sum()), TINY), dtype=np.float64)

    def _turned(self, likely: Likely) -> Likely:
        """The likeliest of some headings, then of some scales."""
        step = STEP_M / self._pair.half_m
        for turn, stretch in ((step, 0.0), (0.0, step)):
            others = [self._peak(self._at(likely.T, k * turn, k * stretch)) for k in TURNS]
            likely = max([likely, *others], key=lambda one: one.nats)
        return likely

    def _at(self, T: FloatArray, turn_rad: float, log_scale: float) -> FloatArray:
        """(4, 4) T, turned and scaled about the source's middle."""
        shift = moved(T, self._pair.centre_m) - self._pair.centre_m
        return about(self._pair.centre_m, yaw_of(T) + turn_rad, scale_of(T) * float(np.exp(log_scale)), shift)

    def _peak(self, T: FloatArray, reach_m: float = 1.0, step: int = 1) -> Likely:
        """The likeliest place about T, at its heading and scale."""
        nats, at_m = self._likely(T, reach_m, step)
        k = np.unravel_index(int(np.argmax(nats)), nats.shape)
        peak = T.copy()
        peak[:2, 3] += at_m[k]
        return Likely(peak, float(nats[k]))

    def _likely(self, T: FloatArray, reach_m: float, step: int) -> tuple[FloatArray, FloatArray]:
        """(V, U) nats and (V, U, 2) where, east and north of T's place, as consensus.beside."""
        nats, at_m = self._of_ground(T, reach_m, step)
        east, north = np.moveaxis(at_m + (moved(T, self._pair.centre_m) - self._pair.centre_m)[:2], -1, 0)
        far = of_place(east, north, self._prior) + of_turn(yaw_of(T), scale_of(T), self._prior)
        return nats - NATS * far, at_m

    def _of_ground(self, T: FloatArray, reach_m: float, step: int) -> tuple[FloatArray, FloatArray]:
        """The same without the prior."""
        blocks = beside(self._cells, self._relief, T, reach_m, step)
        xy = moved(T, self._pair.centre_m)[:2] + blocks.at_m.reshape(-1, 2)
        slopes = self._lasting.nats(Places(xy, np.full(len(xy), yaw_of(T)), np.full(len(xy), scale_of(T))))
        return blocks.nats / ALIKE + slopes.reshape(blocks.nats.shape), blocks.at_m
