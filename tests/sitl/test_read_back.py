"""What the autopilots made of us, by their own logs: ArduPilot's belief in our covariance, PX4's source of position."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.adapters.logs.dataflash_format import messages
from visloc_companion.adapters.logs.recording import Losses
from visloc_companion.adapters.logs.ulog_format import read_topics
from visloc_companion.app.journal import read_journal
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.types import Injection

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(900)]
TOLERANCE = 0.05


def meant_sigmas_m(folder: Path) -> dict[int, float]:
    """The larger semi-axis of what was injected, as one of many, by the time stamp in microseconds."""
    (journal,) = folder.glob("*.mcap")
    injections = [entry.command for entry in read_journal(journal) if isinstance(entry.command, Injection)]
    return {i.t_ns // 1000: max(i.stream_sigma_m, math.sqrt(np.linalg.eigvalsh(np.array(i.cov_ne_m2))[1])) for i in injections}


def believed_sigmas_m(folder: Path) -> dict[int, float]:
    """VISP.PErr by the same stamp."""
    (log,) = (folder / "logs").glob("*.BIN")
    data = log.read_bytes()
    read = messages(data, frozenset(("VISP",)), Losses(), 0, len(data), {})
    return {int(visp["RTimeUS"]): float(visp["PErr"]) for _, visp in read}


def test_ardupilot_believes_the_sigma_that_was_meant(fly, tmp_path: Path) -> None:
    fly(Simulator.ARDUCOPTER, "jam", duration_s=60.0, jam_at_s=20.0, lands=False)
    meant, believed = meant_sigmas_m(tmp_path), believed_sigmas_m(tmp_path)
    both = sorted(meant.keys() & believed.keys())
    assert len(both) > 200
    ratios = np.array([believed[t_us] / meant[t_us] for t_us in both])
    assert np.abs(ratios - 1).max() < TOLERANCE
    assert np.ptp([meant[t_us] for t_us in both]) > 0.05  # or the same number twice would pass


FLAGS = "estimator_status_flags"
SETTLED_S = 2.0


def fused(folder: Path) -> list[tuple[float, bool, bool]]:
    """When (s), and whether EKF2 fused GNSS and external positions then."""
    (log,) = (folder / "log").glob("*/*.ulg")
    rows = read_topics(log.read_bytes(), (FLAGS,), Losses())[FLAGS]
    return [(row["timestamp"] * 1e-6, bool(row["cs_gnss_pos"]), bool(row["cs_ev_pos"])) for row in rows]


def test_px4_flies_on_the_source_that_it_was_switched_to(fly, tmp_path: Path) -> None:
    """EKF2_GPS_CTRL alone, set in flight: external positions alone are fused, and then GNSS again."""
    _, log = fly(Simulator.PX4, "gnss_back", duration_s=90.0, jam_at_s=20.0, gnss_back_at_s=40.0)
    vision_s = log.at("source vision")
    assert vision_s is not None
    gnss_s = next(t_s for t_s, name in log.marks if name == "source gnss" and t_s > vision_s)
    states = fused(tmp_path)
    on_vision = [state[1:] for state in states if vision_s + SETTLED_S < state[0] < gnss_s]
    afterwards = [gnss for t_s, gnss, _ in states if t_s > gnss_s + SETTLED_S]
    assert len(on_vision) > 10
    assert set(on_vision) == {(False, True)}
    assert len(afterwards) > 10
    assert all(afterwards)
    assert not any("EKF does not use" in text for _, text in log.texts)
