"""All rules."""

from __future__ import annotations

from visloc_companion.doctor.finding import Rule
from visloc_companion.doctor.rules import (
    ardupilot_ekf,
    ardupilot_link,
    ardupilot_vision,
    camera,
    configuration,
    firmware,
    gimbal,
    link,
    maps,
    model,
    position,
    px4_height,
    px4_link,
    px4_output,
    px4_vision,
    system,
)

THEMES: dict[str, tuple[Rule, ...]] = {
    "ArduPilot's parameters": (*ardupilot_vision.RULES, *ardupilot_ekf.RULES, *ardupilot_link.RULES),
    "PX4's parameters": (*px4_vision.RULES, *px4_height.RULES, *px4_output.RULES, *px4_link.RULES),
    "Firmware": firmware.RULES,
    "Link and time": link.RULES,
    "Position": position.RULES,
    "Camera": (*camera.RULES, *gimbal.RULES),
    "Map": maps.RULES,
    "Network": model.RULES,
    "Computer": system.RULES,
    "Configuration": configuration.RULES,
}
RULES: tuple[Rule, ...] = tuple(rule for rules in THEMES.values() for rule in rules)
"""In the order of the themes."""
