"""Position, protection levels, fixes and GNSS of a snapshot, as the page and /api/status state them."""

from __future__ import annotations

import math
from typing import Any

from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.types import GeoPoint
from visloc_companion.web import words
from visloc_companion.web.ellipse import ellipse_95
from visloc_companion.web.reading import count, covariance, flag, number, part, place, text, texts

COURSE_FROM_MPS = 1.0
"""Slower than this, a velocity tells no direction."""
GNSS_FRESH_S = 2.0
MAX_REASONS = 8


def mode(status: dict[str, Any]) -> dict[str, str]:
    """Name, label and meaning of the mode; "unknown" for what is none."""
    name = text(status.get("mode"))
    label, meaning = words.MODES.get(name, ("UNKNOWN", "the daemon has not said"))
    return {"name": name if name in words.MODES else "unknown", "label": label, "means": meaning}


def position(snapshot: dict[str, Any]) -> dict[str, Any] | None:
    """Where the vehicle is: place, speed, where it points, and the 95 % ellipse of the claimed covariance."""
    status = part(snapshot, "status")
    where = place(status.get("place"))
    if where is None:
        return None
    cov = covariance(status.get("cov_ne_m2"))
    ellipse = None if cov is None else ellipse_95(cov)
    velocity = status.get("v_ned_mps")
    parts = [number(v) for v in velocity] if isinstance(velocity, list) and len(velocity) == 3 else [None] * 3
    north, east, down = parts
    speed = None if north is None or east is None else math.hypot(north, east)
    heading, points = number(snapshot.get("heading_deg"), 0.0, 360.0), "heading"
    if heading is None and north is not None and east is not None and speed is not None and speed >= COURSE_FROM_MPS:
        heading, points = math.degrees(math.atan2(east, north)) % 360.0, "course"
    return {
        "lat_deg": where[0],
        "lon_deg": where[1],
        "h_amsl_m": number(part(status, "place").get("h_amsl_m")),
        "direction_deg": heading,
        "direction_is": None if heading is None else points,
        "speed_mps": speed,
        "climb_mps": None if down is None else -down,
        "radius_95_m": None if ellipse is None else ellipse.semi_major_m,
        "ellipse_95": None
        if ellipse is None
        else {
            "semi_major_m": ellipse.semi_major_m,
            "semi_minor_m": ellipse.semi_minor_m,
            "azimuth_deg": ellipse.azimuth_deg,
        },
    }


def integrity(status: dict[str, Any]) -> dict[str, Any]:
    """Protection levels beside their alert limits, and in words whether the position may be used."""
    known = place(status.get("place")) is not None
    level, limit = number(status.get("protection_level_m"), 0.0), number(status.get("alert_limit_m"), 0.0)
    available, alert = flag(status.get("available")), flag(status.get("alert"))
    if not known:
        says = "no position"
    elif alert:
        says = "ALERT: may be further off than allowed"
    elif available:
        says = "within the alert limits"
    else:
        says = "not within the alert limits"
    return {
        "protection_level_m": level if known else None,
        "alert_limit_m": limit,
        "vertical_protection_level_m": number(status.get("vertical_protection_level_m"), 0.0) if known else None,
        "vertical_alert_limit_m": number(status.get("vertical_alert_limit_m"), 0.0),
        "available": bool(available) and known,
        "alert": bool(alert),
        "open_places": count(status.get("open_places")) or 0,
        "says": says,
    }


def fix(snapshot: dict[str, Any]) -> dict[str, Any]:
    """The fix that the position rests on, and the localiser's newest answer."""
    taken, answer = part(snapshot, "fix"), part(snapshot, "answer")
    age_s = number(part(snapshot, "status").get("age_of_fix_s"), 0.0)
    reason = text(answer.get("reason"))
    return {
        "age_s": age_s,
        "source": "none yet" if age_s is None else words.source(text(taken.get("method")) or None),
        "answer": None
        if not answer
        else {
            "reason": reason or None,
            "says": f"no fix: {words.said(reason, words.NO_FIX)}" if reason else "a fix",
            "method": text(answer.get("method")),
            "elapsed_ms": number(answer.get("elapsed_ms"), 0.0),
            "age_s": number(answer.get("age_s"), 0.0),
        },
    }


def gnss(snapshot: dict[str, Any]) -> dict[str, Any]:
    """The verdict with its reasons in words, and what the receiver itself says; its place only while it has one."""
    status, report = part(snapshot, "status"), part(snapshot, "gnss")
    verdict = text(status.get("verdict"))
    reasons = texts(status.get("reasons"), MAX_REASONS)
    fix_type, age_s = count(report.get("fix_type")), number(report.get("age_s"), 0.0)
    has_place = age_s is not None and age_s <= GNSS_FRESH_S and fix_type is not None and fix_type >= 2
    where = place(report) if has_place else None
    own = place(status.get("place"))
    label = words.VERDICTS.get(verdict, "unknown")
    if verdict == "denied" and reasons == ["no_data"]:
        label = "waiting"
    return {
        "verdict": verdict if verdict in words.VERDICTS else "unknown",
        "label": label,
        "reasons": reasons,
        "says": [words.said(reason, words.GNSS_REASONS) for reason in reasons],
        "lat_deg": where and where[0],
        "lon_deg": where and where[1],
        "off_m": None if where is None or own is None else distance_m(GeoPoint(*where, 0.0), GeoPoint(*own, 0.0)),
        "fix": words.GNSS_FIX_TYPES.get(fix_type, "3D") if fix_type is not None else "nothing heard",
        "n_satellites": count(report.get("n_satellites")),
        "h_acc_m": number(report.get("h_acc_m"), 0.0),
        "age_s": age_s,
    }
