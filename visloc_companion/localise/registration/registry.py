"""Names to registration methods."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.errors import ConfigError
from visloc_companion.localise.registration.base import RegistrationMethod
from visloc_companion.localise.registration.features import FeaturesRegistration
from visloc_companion.localise.registration.gicp import GicpRegistration
from visloc_companion.localise.registration.height_search import HeightSearchRegistration

METHODS: dict[str, Callable[[float], RegistrationMethod]] = {
    "height-search": HeightSearchRegistration,
    "gicp": GicpRegistration,
    "features": FeaturesRegistration,
}
"""Constructors of a largest `probability_wrong` that is still answered; the first is the default."""
DEFAULT_METHOD = "height-search"
DEFAULT_MAX_PROBABILITY_WRONG = 0.05
"""On the places and worlds fitted on, each by weights of the others, this took every right answer of level normal on dense
references and no wrong one; 0.1 took a wrong one."""


def make_registration(method: str, max_probability_wrong: float = DEFAULT_MAX_PROBABILITY_WRONG) -> RegistrationMethod:
    """The method of a name; it declines where it is wrong with more than `max_probability_wrong` (1: it answers what it finds).

    Raises ConfigError for a name that this version does not have, or where the method needs a library that is not installed.
    """
    if method not in METHODS:
        raise ConfigError(f"unknown method {method!r}", where="registration.method", remedy=f"use one of {', '.join(METHODS)}")
    if not 0 <= max_probability_wrong <= 1:
        raise ConfigError(
            f"{max_probability_wrong} is not a probability", where="registration.max_probability_wrong", remedy="give 0 to 1"
        )
    return METHODS[method](max_probability_wrong)
