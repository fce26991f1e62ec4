"""The view as Prometheus metrics. Names are stable (docs/dashboard.md); what is not current is not stated."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from visloc_companion.web.words import MODES, VERDICTS

GAUGES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("visloc_radius_95_meters", "Semi-major axis of the 95 % ellipse of the claimed position.", ("position", "radius_95_m")),
    ("visloc_protection_level_meters", "Horizontal protection level.", ("integrity", "protection_level_m")),
    ("visloc_alert_limit_meters", "Horizontal alert limit.", ("integrity", "alert_limit_m")),
    (
        "visloc_vertical_protection_level_meters",
        "Vertical protection level.",
        ("integrity", "vertical_protection_level_m"),
    ),
    ("visloc_vertical_alert_limit_meters", "Vertical alert limit.", ("integrity", "vertical_alert_limit_m")),
    ("visloc_available", "1 while both levels are within their limits.", ("integrity", "available")),
    ("visloc_alert", "1 while a level has exceeded its limit for long enough to count.", ("integrity", "alert")),
    ("visloc_open_places", "Places that the frames since the last fix leave open.", ("integrity", "open_places")),
    ("visloc_fix_age_seconds", "Age of the last fix that was taken.", ("fix", "age_s")),
    ("visloc_injecting", "1 while positions are sent to the autopilot.", ("injection", "now")),
    ("visloc_gnss_off_meters", "Distance of GNSS from the position.", ("gnss", "off_m")),
    ("visloc_gnss_satellites", "Satellites that the receiver uses.", ("gnss", "n_satellites")),
)
COUNTERS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("visloc_injections", "Positions sent to the autopilot since the daemon's start.", ("injection", "sent")),
    ("visloc_injections_dropped", "Positions that a newer one overtook before it was sent.", ("injection", "dropped")),
    ("visloc_line_left_out", "Messages that the line to the autopilot was too slow for.", ("line", "left_out")),
)


def metrics_text(view: dict[str, Any], streams: int) -> bytes:
    """The text exposition format of a view, and how many browsers look."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_View(view, streams))
    return generate_latest(registry)


class _View(Collector):
    def __init__(self, view: dict[str, Any], streams: int) -> None:
        self._view, self._streams = view, streams

    def collect(self) -> Iterator[Metric]:
        view, live = self._view, self._view["state"] == "live"
        yield GaugeMetricFamily("visloc_up", "1 while the daemon answers and its navigator goes on.", value=float(live))
        yield GaugeMetricFamily("visloc_web_streams", "Browsers that look at the dashboard.", value=float(self._streams))
        if not live:
            return
        yield _choice("visloc_mode", "Mode of the navigator.", "mode", view["mode"]["name"], tuple(MODES))
        yield _choice("visloc_gnss_verdict", "Verdict on GNSS.", "verdict", view["gnss"]["verdict"], tuple(VERDICTS))
        for name, words, path in GAUGES:
            if (value := _at(view, path)) is not None:
                yield GaugeMetricFamily(name, words, value=value)
        for name, words, path in COUNTERS:
            if (value := _at(view, path)) is not None:
                yield CounterMetricFamily(name, words, value=value)
        healthy = GaugeMetricFamily("visloc_part_healthy", "1 where a part of the daemon is in order.", labels=["part"])
        for row in view["health"]:
            if row["ok"] is not None:
                healthy.add_metric([row["part"]], float(row["ok"]))
        yield healthy


def _choice(name: str, words: str, label: str, chosen: str, all_of: tuple[str, ...]) -> Metric:
    family = GaugeMetricFamily(name, words, labels=[label])
    for one in all_of:
        family.add_metric([one], float(one == chosen))
    return family


def _at(view: dict[str, Any], path: tuple[str, ...]) -> float | None:
    found: Any = view
    for name in path:
        found = found[name] if isinstance(found, dict) else None
    return None if found is None else float(found)
