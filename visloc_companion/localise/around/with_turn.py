"""A localiser whose answers also say how the camera turned since the frame before, which tells when frames were really taken.

The turn comes first: what was known of the tilt of the frame before is carried on by what the pictures show, not by the change
of an attitude that errs by as much within a second where gyroscopes are poor.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from visloc_companion.errors import OutsideMap, Reason
from visloc_companion.geo.tilt import CAMERA_SIGMA, by_camera, tilt_gained
from visloc_companion.localise.asking import Asking
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.odometry.below import heights_above
from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.localise.odometry.surface_window import SurfaceWindow
from visloc_companion.localise.odometry.true_heading import TrueHeading
from visloc_companion.localise.odometry.turn_follow import HeightsAbove
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Fix, Image, LocaliseRequest, NoFix, PosePrior, TiltPrior, Turn


class WithTurn(Asking):
    """protocols.Localiser: asks another one and adds `turn` and `turn_since_kept` to its answer where they are seen."""

    def __init__(
        self,
        localiser: Localiser,
        model: CameraModel,
        window: SurfaceWindow | None = None,
        heading: TrueHeading | None = None,
    ) -> None:
        super().__init__(localiser)
        self._watch, self._window = TurnWatch(model), window or SurfaceWindow()
        self._heading = heading or TrueHeading()

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The other localiser's answer, with the camera's turn. An old picture of a frozen camera tells of none, nor does the
        next one beside it."""
        turns = self._watch.step(pixels, request.frame.t_ns, request.prior.q_ned_frd, self._heights(request.believed, ref))
        since_last = turns.since_last
        self._heading.seen(request.frame.t_ns, request.prior.q_ned_frd, since_last)
        asked = request if since_last is None else replace(request, prior=_carried_on(request.prior, since_last))
        found = self._localiser.localise(asked, pixels, ref)
        if isinstance(found, NoFix) and found.reason is Reason.FROZEN:
            self._watch.forget()
            return found
        return found if since_last is None else replace(found, turn=since_last, turn_since_kept=turns.since_kept)

    def _heights(self, prior: PosePrior, ref: ReferenceMap) -> HeightsAbove | None:
        up_m = prior.place.h_amsl_m
        try:
            surface = self._window.about(up_m, ref, local_frame(prior.place, ref))
        except OutsideMap:
            return None
        return None if surface is None else partial(heights_above, camera_up_m=up_m, surface=surface)


def _carried_on(prior: PosePrior, turn: Turn) -> PosePrior:
    """The prior with the tilt of the frame before, carried on by the turn, where that is surer."""
    if prior.tilt is None or prior.tilt.before is None or prior.tilt.before.t_ns != turn.t_from_ns:
        return prior
    before = prior.tilt.before
    gained, cov = tilt_gained(before.q_ned_frd, turn, prior.q_ned_frd)
    wrong = by_camera(before.q_ned_frd, prior.q_ned_frd)
    cov = cov + (wrong * np.square(CAMERA_SIGMA)) @ wrong.T
    sigma_rad = math.sqrt(before.sigma_rad**2 + float(np.linalg.eigvalsh(cov)[-1]))
    if sigma_rad >= prior.tilt.sigma_rad:
        return prior
    north, east = (np.array(before.turn_ne_rad) + gained).tolist()
    return replace(prior, tilt=TiltPrior((north, east), sigma_rad, before))
