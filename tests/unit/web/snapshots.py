"""A daemon's snapshot for tests, in the shape of `Daemon.snapshot`."""

from __future__ import annotations

import copy
from typing import Any

T_NS = 500_000_000_000
SNAPSHOT: dict[str, Any] = {
    "schema": 1,
    "t_ns": T_NS,
    "status": {
        "type": "Status",
        "t_ns": T_NS,
        "mode": "aiding",
        "verdict": "suspect",
        "reasons": ["vision_disagrees", "receiver_spoofing"],
        "place": {"lat_deg": 47.4, "lon_deg": 8.55, "h_amsl_m": 588.0},
        "v_ned_mps": [8.0, 6.0, -0.5],
        "cov_ne_m2": [[4.0, 0.0], [0.0, 1.0]],
        "sigma_d_m": 2.0,
        "protection_level_m": 12.0,
        "age_of_fix_s": 0.8,
        "injected": True,
        "reset_counter": 0,
        "vertical_protection_level_m": 6.0,
        "height_offset_m": 0.2,
        "alert_limit_m": 40.0,
        "vertical_alert_limit_m": 50.0,
        "available": True,
        "alert": False,
        "open_places": 0,
    },
    "link_up": True,
    "worker": {"up": True, "pid": 4242, "restarts": 0, "given_up": False},
    "journal": {"dropped": 0, "problem": ""},
    "cycle_slips": 0,
    "slow_steps": 0,
    "slowest_ms": 1.2,
    "injections": {"sent": 321, "dropped": 0},
    "line": {"left_out": 7, "slow": False},
    "late": [],
    "camera": True,
    "autopilot": {"kind": "ardupilot", "version": "4.6.2", "armed": True},
    "heading_deg": 40.0,
    "gnss": {"lat_deg": 47.4009, "lon_deg": 8.55, "fix_type": 3, "n_satellites": 14, "h_acc_m": 0.9, "age_s": 0.1},
    "fix": {"method": "deep", "age_s": 0.8},
    "answer": {"method": "deep", "reason": "ambiguous", "elapsed_ms": 90.0, "age_s": 0.2},
    "frame_age_s": 0.3,
    "notices": [
        {"severity": "warning", "text": "visloc: GNSS not trusted, camera says elsewhere", "age_s": 12.0},
        {"severity": "notice", "text": "visloc: AIDING", "age_s": 13.0},
    ],
}


def snapshot(t_s: float = 0.0, **status: Any) -> dict[str, Any]:
    """The snapshot so many seconds later, with fields of its status replaced."""
    made = copy.deepcopy(SNAPSHOT)
    made["t_ns"] = made["status"]["t_ns"] = T_NS + round(t_s * 1e9)
    made["status"] |= status
    return made
