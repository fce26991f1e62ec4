"""Failsafe and flight modes of the simulated autopilot (autopilot facts, sections 1.5 and 6)."""

from __future__ import annotations

from collections.abc import Mapping

from visloc_companion.sim.autopilots.autopilot_flight import Flight
from visloc_companion.types import AutopilotKind

CHECK_PERIOD_S, CHECK_COUNT = 0.1, 9
ARDUPILOT_TEXT, PX4_TEXT = "EKF Failsafe: changed to LAND", "Failsafe activated: blind land"
MODES: dict[tuple[AutopilotKind, str], dict[str, int]] = {
    (AutopilotKind.ARDUPILOT, "copter"): {"mission": 3, "by_hand": 2, "takeoff": 3, "land": 9, "landed": 9},
    (AutopilotKind.ARDUPILOT, "plane"): {"mission": 10, "by_hand": 5, "takeoff": 10, "land": 10, "landed": 10},
    (AutopilotKind.PX4, "copter"): {
        "mission": 4 << 16 | 4 << 24,
        "by_hand": 2 << 16,
        "takeoff": 4 << 16 | 2 << 24,
        "land": 4 << 16 | 6 << 24,
        "landed": 4 << 16 | 6 << 24,
    },
    (AutopilotKind.PX4, "plane"): {
        "mission": 4 << 16 | 4 << 24,
        "by_hand": 2 << 16,
        "takeoff": 4 << 16 | 2 << 24,
        "land": 4 << 16 | 6 << 24,
        "landed": 4 << 16 | 6 << 24,
    },
}
"""HEARTBEAT.custom_mode: ArduPilot's mode numbers (AUTO, ALT_HOLD/FBWA, LAND), PX4's main and sub mode (mission, land)."""


def custom_mode(kind: AutopilotKind, vehicle: str, phase: str) -> int:
    """HEARTBEAT.custom_mode of a phase of flight."""
    return MODES[kind, vehicle][phase]


class Failsafe:
    """Ends the mission in a landing when the estimator is not to be trusted; planes have none.

    ArduPilot: ekf_check.cpp, 10 Hz; no position, or two of {position, velocity (twice at double)} at or above FS_EKF_THRESH,
    nine times running. PX4: at once when the position becomes invalid. Only after there was a position; never reverted.
    """

    def __init__(self, kind: AutopilotKind, vehicle: str) -> None:
        self._kind, self._exempt = kind, vehicle == "plane"
        self._due_s, self._count = 0.0, 0
        self.text: str | None = None
        self.t_s: float | None = None

    def step(self, flight: Flight, parameters: Mapping[str, float]) -> list[str]:
        """Check; returns the text on the step at which it fires."""
        if self._exempt or self.text is not None or flight.phase not in ("mission", "takeoff"):
            return []
        if self._kind is AutopilotKind.ARDUPILOT:
            if flight.t_s < self._due_s:
                return []
            self._due_s = flight.t_s + CHECK_PERIOD_S
            self._count = self._count + 1 if _ekf_bad(flight, parameters["FS_EKF_THRESH"]) else 0
            if self._count < CHECK_COUNT:
                return []
        elif flight.health().position_ok:
            return []
        self.text = ARDUPILOT_TEXT if self._kind is AutopilotKind.ARDUPILOT else PX4_TEXT
        self.t_s, flight.phase = flight.t_s, "land"
        return [self.text]


def _ekf_bad(flight: Flight, threshold: float) -> bool:
    health = flight.health()
    position, velocity = health.position_ratio**0.5, health.velocity_ratio**0.5
    votes = (position >= threshold) + (velocity >= threshold) + (velocity >= 2 * threshold)
    return not health.position_ok or votes >= 2
