"""What a MAVLink session is told: frozen values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.outputs.fence import Fence
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.signing import SigningSettings
from visloc_companion.types import GeoPoint


class CompanionState(IntEnum):
    """HEARTBEAT.system_status of the companion (MAV_STATE)."""

    STANDBY = mav.MAV_STATE_STANDBY
    ACTIVE = mav.MAV_STATE_ACTIVE
    CRITICAL = mav.MAV_STATE_CRITICAL


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Identity, source switching and the times of the conversation.

    `system_id` 0 takes the first autopilot that is heard. `component_id` is our own. The source sets and `px4_gps_ctrl` are
    those of section `injection` of the configuration. `timeout_s` of silence is a lost link; `reconnect_s` is the first pause
    between tries to open the connection anew. A stream is judged over `window_s` after its request was acknowledged.
    `output` None chooses by the autopilot (outputs/choice.py); `fence` None lets positions go anywhere.
    `left_system_id` is the autopilot that a daemon before this one sent positions to, 0 where there was none: it is asked for its
    HEARTBEAT as soon as it says anything. `operator_systems` are the ground stations whose word on the position is heard.
    `origin_to_set` is given to an autopilot without an origin and without GNSS, None is not.
    """

    system_id: int = 0
    left_system_id: int = 0
    component_id: int = 197
    operator_systems: tuple[int, ...] = (255,)
    gnss_source_set: int = 1
    vision_source_set: int = 2
    px4_gps_ctrl: int = 7
    timeout_s: float = 3.0
    reconnect_s: float = 2.0
    heartbeat_s: float = 1.0
    timesync_s: float = 0.25
    ack_timeout_s: float = 0.7
    window_s: float = 3.0
    origin_unknown_s: float = 1.0
    origin_known_s: float = 5.0
    output: Output | None = None
    position_sensor_id: int = 1
    external_estimate_period_s: float = 2.0
    max_step_m: float = 5.0
    fence: Fence | None = None
    origin_to_set: GeoPoint | None = None
    signing: SigningSettings | None = None
