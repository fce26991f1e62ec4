"""What localises in flight: the image localiser of a name, the structure vote beside it, and no frame twice."""

from __future__ import annotations

from visloc_companion.localise.around.freshness import FreshFramesOnly
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.mapped.map_light import MapLight
from visloc_companion.localise.registration.base import RegistrationMethod
from visloc_companion.localise.registry import make_localiser
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.protocols import Localiser
from visloc_companion.types import CameraModel

MOST_WORK = 1e8
"""Of the structure vote's search (registration/search.py): some ten seconds on one core. A position that was lost for long, with
frames whose baseline is hardly known, would have it search for minutes, and whoever asks wait."""


def flight_registration() -> RegistrationMethod:
    """What places the structure vote's cloud; it judges the answers itself, by the lead of their scores or of what has not
    changed."""
    from visloc_companion.localise.registration.height_search import HeightSearchRegistration

    return HeightSearchRegistration(1.0, MOST_WORK, by_score=True, by_unchanged=True)


def flight_localiser(
    method: str,
    model: CameraModel,
    features: Features | None,
    *,
    max_probability_wrong: float,
    max_search_radius_m: float,
    threads: int,
    structure: bool,
    light: MapLight | None = None,
) -> Localiser:
    """The localiser of a name (localise/registry.py) with the structure vote, if wanted; `light` may be shared with others.

    Raises ConfigError as `make_localiser`.
    """
    image = make_localiser(
        method,
        model,
        features=features,
        max_probability_wrong=max_probability_wrong,
        max_search_radius_m=max_search_radius_m,
        threads=threads,
        light=light,
    )
    if not structure:
        return FreshFramesOnly(image)
    # here, not above, as in flight_registration: without the vote the worker starts without the libraries of the registration
    from visloc_companion.localise.around.votes import TwoVotes
    from visloc_companion.localise.structure.localiser import StructureLocaliser

    settings = LocaliserSettings(max_probability_wrong, max_search_radius_m)
    return FreshFramesOnly(TwoVotes(image, StructureLocaliser(model, settings, flight_registration())))
