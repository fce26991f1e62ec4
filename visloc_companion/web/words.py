"""What the page says, in words that an operator knows."""

from __future__ import annotations

MODES = {
    "waiting": ("WAITING", "link, origin, attitude or a first position is missing: nothing is sent"),
    "shadow": ("SHADOW", "knows where it is and sends nothing"),
    "aiding": ("AIDING", "sends positions that rest on recent fixes"),
    "dead_reckoning": ("DEAD RECKONING", "sends positions that velocity carries on from the last fix"),
    "lost": ("LOST", "too unsure of the position to send it"),
}
VERDICTS = {"ok": "trusted", "suspect": "not trusted", "denied": "lost"}
GNSS_REASONS = {
    "no_data": "nothing received from it yet",
    "silence": "the receiver has fallen silent",
    "no_fix": "the receiver has no position",
    "few_satellites": "too few satellites",
    "accuracy": "the receiver states a poor accuracy",
    "autopilot_glitch": "the autopilot's filter sees a glitch",
    "autopilot_rejects": "the autopilot's filter rejects it",
    "vision_disagrees": "the camera sees the vehicle elsewhere",
    "odometry_disagrees": "it moves unlike what the camera sees moving",
    "height_disagrees": "its height moves unlike the barometer's",
    "receiver_spoofing": "the receiver reports spoofing",
    "receiver_jamming": "the receiver reports jamming",
    "receiver_authentication": "signals are not authentic",
    "receivers_differ": "two receivers differ",
    "clock_jump": "its time jumped",
    "off_map": "it places the vehicle outside the map",
    "off_surface": "its height is unlike the map's surface",
    "out_of_reach": "it came back at a place that cannot be reached",
    "probation": "it is good again and being checked",
}
NO_FIX = {
    "outside_map": "the ground in view is outside the map",
    "low_texture": "the ground shows too little texture",
    "too_dark": "the picture is too dark",
    "overexposed": "the picture is overexposed",
    "blurred": "the picture is blurred",
    "no_baseline": "the vehicle has not moved enough for stereo",
    "no_parallax": "the ground shows no parallax",
    "low_overlap": "too little of the picture lies on the map",
    "horizon_in_view": "the horizon is in view",
    "too_low": "too low above the ground",
    "no_match": "the picture is not like the map",
    "ambiguous": "several places look alike",
    "blocks_disagree": "parts of the picture disagree",
    "inconsistent_with_prior": "the match is not where the vehicle can be",
    "refinement_diverged": "the match settles nowhere",
    "search_too_wide": "the area to search is too large",
    "too_few_features": "too few points are found again",
    "pose_failed": "no pose fits the match",
    "moving_surface": "what is seen moves, water perhaps",
    "bad_frame": "the frame is unreadable",
    "frozen": "the picture stands still: the camera is frozen",
    "bad_input": "the localiser failed on this frame",
    "worker_timeout": "the worker took too long",
    "worker_died": "the worker died",
    "computation_differs": "computed twice, the answers differ",
    "switched_off": "the localiser is switched off",
    "superseded": "a newer frame came first",
}
SOURCES = {"terrain": "terrain profile (rangefinder)", "structure": "shape of the ground (stereo)"}
"""By method; the methods' own modules are not imported, which would load all that a localiser needs."""
GNSS_FIX_TYPES = {0: "no receiver", 1: "no fix", 2: "2D", 3: "3D", 4: "DGNSS", 5: "RTK float", 6: "RTK fixed"}


def said(reason: str, words: dict[str, str]) -> str:
    """A reason in words; one that is not listed (a newer daemon's) with spaces."""
    return words.get(reason, reason.replace("_", " "))


def source(method: str | None) -> str:
    """Where a fix came from."""
    if method is None:
        return "camera or terrain"
    return SOURCES.get(method, f"camera against map ({method})")


def span(seconds: float) -> str:
    """How long, as short as a glance: 0.4 s, 12 s, 3 min 05 s, 2 h 10 min."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
