"""The framer and the codec on telemetry that was really recorded."""

from collections import Counter
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.codec import examine
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.errors import Reason
from visloc_companion.types import Attitude, EstimatorStatus, Gnss, PriorPose

pytestmark = pytest.mark.shared


def outcomes(log: Path) -> Counter[object]:
    """Read as a raw stream: the eight bytes of time before each packet are noise to the framer."""
    framer = Framer()
    found = (examine(msg, 0) for msg in framer.feed(log.read_bytes()))
    return Counter(outcome if isinstance(outcome, Reason) else type(outcome) for outcome in found)


def test_a_real_copter_over_a_lossy_radio(shared_data):
    counts = outcomes(shared_data / "logs" / "copter_real_2015.tlog")
    assert (counts[Attitude], counts[Gnss], counts[EstimatorStatus]) == (2829, 2858, 2824)
    assert counts[PriorPose] + counts[Reason.NO_ORIGIN] == 2833
    assert counts[Reason.NO_ORIGIN] > 0  # it starts without a fix


def test_a_bench_without_fix_has_no_position(shared_data):
    counts = outcomes(shared_data / "logs" / "plane_bench_nofix_2018.tlog")
    assert (counts[PriorPose], counts[Reason.NO_ORIGIN], counts[Gnss]) == (0, 278, 295)
