"""PX4: how soon the position and velocity that it flies by follow its filter. Source: output_predictor.cpp."""

from __future__ import annotations

from visloc_companion.doctor.finding import Level, Rule
from visloc_companion.doctor.rules.parameter import parameter, within
from visloc_companion.types import AutopilotKind

TAU_S, MOST_S = 0.1, 0.15

RULES: tuple[Rule, ...] = tuple(
    parameter(
        f"px4-output-{what}",
        AutopilotKind.PX4,
        name,
        f"The {what} that PX4 flies by follows its filter with this time constant. With the default 0.25 s every correction by "
        "vision, already 0.2 s old, comes as much later again.",
        f"{name} = {TAU_S:g}",
        within(lambda value: value <= MOST_S, TAU_S, Level.AMBER),
        poses=True,
    )
    for name, what in (("EKF2_TAU_POS", "position"), ("EKF2_TAU_VEL", "velocity"))
)
"""About the output predictor."""
