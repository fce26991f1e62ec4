"""What ArduPilot believed of our covariance, read back from its own log: VISP.PErr against the sigma that was meant."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.adapters.logs.dataflash_format import messages
from visloc_companion.adapters.logs.recording import Losses
from visloc_companion.app.journal import read_journal
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.types import Injection

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(900)]
TOLERANCE = 0.05


def meant_sigmas_m(folder: Path) -> dict[int, float]:
    """The larger semi-axis of what was injected, by the time stamp in microseconds."""
    (journal,) = folder.glob("*.mcap")
    injections = [entry.command for entry in read_journal(journal) if isinstance(entry.command, Injection)]
    return {i.t_ns // 1000: math.sqrt(np.linalg.eigvalsh(np.array(i.cov_ne_m2))[1]) for i in injections}


def believed_sigmas_m(folder: Path) -> dict[int, float]:
    """VISP.PErr by the same stamp."""
    (log,) = (folder / "logs").glob("*.BIN")
    return {int(visp["RTimeUS"]): float(visp["PErr"]) for _, visp in messages(log.read_bytes(), frozenset(("VISP",)), Losses())}


def test_ardupilot_believes_the_sigma_that_was_meant(fly, tmp_path: Path) -> None:
    fly(Simulator.ARDUCOPTER, "jam", duration_s=60.0, jam_at_s=20.0, lands=False)
    meant, believed = meant_sigmas_m(tmp_path), believed_sigmas_m(tmp_path)
    both = sorted(meant.keys() & believed.keys())
    assert len(both) > 200
    ratios = np.array([believed[t_us] / meant[t_us] for t_us in both])
    assert np.abs(ratios - 1).max() < TOLERANCE
    assert np.ptp([meant[t_us] for t_us in both]) > 0.05  # or the same number twice would pass
