"""Which rows of a ULog are of which receiver, as PX4 sends them: GPS_RAW_INT of the first, GPS2_RAW of the second.

Until 1.11 `vehicle_gps_position` has an instance for each. Since then it is that of the receiver that flies, or a blend of both,
several times a second, beside `sensor_gps` with an instance for each, by default once a second; `device_id` tells them apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from visloc_companion.adapters.logs.ulog_format import Instances, Row, of_first

GNSS_TOPICS = ("vehicle_gps_position", "sensor_gps")


def receivers(topics: Mapping[str, Instances]) -> list[list[Row]]:
    """Rows of each receiver, the first being that which is logged most often; none, one or two.

    A second one that may be the first again (a blend, rows that do not say whose they are) is left out: it would bear the first
    out, whatever that says.
    """
    name = next((name for name in GNSS_TOPICS if topics.get(name)), None)
    if name is None:
        return []
    first = of_first(topics[name])
    own = _device(first)
    for other in GNSS_TOPICS:
        for number, rows in sorted(topics.get(other, {}).items()):
            if rows is first:
                continue
            device = _device(rows)
            if device != own if device and own else other == name and number == min(topics[name]) + 1:
                return [first, rows]
    return [first]


def _device(rows: list[Row]) -> int:
    """The `device_id` of most rows; 0 where they have none, or are blended of several."""
    return int(Counter(row.get("device_id", 0) for row in rows).most_common(1)[0][0])
