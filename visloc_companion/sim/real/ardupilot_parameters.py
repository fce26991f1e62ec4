"""Parameters that ArduPilot's simulated vehicles need to fly: their frames, tuning, and sensors that count as calibrated."""

from __future__ import annotations

_CALIBRATED: dict[str, float] = {
    **{f"INS_{sensor}OFFS_{axis}": 0.001 for sensor in ("ACC", "ACC2") for axis in "XYZ"},
    **{f"INS_{sensor}SCAL_{axis}": 1.001 for sensor in ("ACC", "ACC2") for axis in "XYZ"},
    "BATT_MONITOR": 4,
    "SERIAL1_BAUD": 921,
    "SIM_WIND_SPD": 4.5,
    "SIM_WIND_DIR": 117,
    "SIM_WIND_TURB": 1.0,
}

COPTER: dict[str, float] = {
    **_CALIBRATED,
    **{f"COMPASS_OFS{n}_{axis}": value for n in ("", "2", "3") for axis, value in zip("XYZ", (5, 13, -18), strict=True)},
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 0,
    "FS_THR_ENABLE": 1,
    "ATC_RAT_YAW_P": 0.3,
    "ATC_RAT_YAW_I": 0.02,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.39,
    "MOT_BAT_VOLT_MIN": 9.6,
    "MOT_BAT_VOLT_MAX": 12.8,
    "WPNAV_ACCEL": 400,
    "WPNAV_JERK": 8,
    "WP_ACC": 4,
    "WP_JERK": 8,
}
"""The accelerations (cm/s²; from 4.7.0 WP_ACC, m/s²) and the jerk between waypoints make it brake briskly. ArduPilot passes over
names of another version."""

PLANE: dict[str, float] = {
    **_CALIBRATED,
    "AIRSPEED_CRUISE": 22,
    "AIRSPEED_MIN": 10,
    "AIRSPEED_MAX": 30,
    "TRIM_THROTTLE": 50,
    "PTCH_LIM_MIN_DEG": -20,
    "PTCH_LIM_MAX_DEG": 25,
    "ROLL_LIMIT_DEG": 65,
    "ARSPD_USE": 1,
    "ARSPD_PIN": 1,
    "ARSPD_BUS": 2,
    "KFF_RDDRMIX": 0.5,
    "WP_LOITER_RAD": 80,
    "WP_RADIUS": 50,
    "RLL2SRV_TCONST": 0.25,
    "RLL2SRV_RMAX": 90,
    "RLL_RATE_P": 0.3,
    "RLL_RATE_I": 0.25,
    "RLL_RATE_D": 0.01743,
    "RLL_RATE_FF": 0.237212,
    "PTCH2SRV_TCONST": 0.25,
    "PTCH2SRV_RMAX_UP": 90,
    "PTCH2SRV_RMAX_DN": 90,
    "PTCH2SRV_RLL": 1,
    "PTCH_RATE_P": 0.15,
    "PTCH_RATE_I": 0.11,
    "PTCH_RATE_D": 0.007265,
    "PTCH_RATE_FF": 0.595723,
    "NAVL1_PERIOD": 15,
    "ACRO_LOCKING": 1,
    "INS_GYR_CAL": 0,
    "SCHED_LOOP_RATE": 200,
}
"""The loop runs at 200 Hz so that the station's ATTITUDE, from which the time of the flight is taken, comes often enough."""
