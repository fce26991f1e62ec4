"""What the camera of a flight looks at."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.errors import MapError
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.scenarios import SCENARIOS
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.seen import simulated_camera
from visloc_companion.sim.setup import FlightArea, FlightSetup
from visloc_companion.types import AutopilotKind, GeoPoint

SIDE = 1200
HOME_M = 480.0


def hillside(slope: float) -> Scene:
    """1 m a pixel, rising to the east, home in its middle."""
    east_m = np.mgrid[0:SIDE, 0:SIDE][1] - SIDE / 2
    pixels = np.random.default_rng(1).integers(0, 255, (SIDE, SIDE, 3)).astype(np.uint8)
    T = np.array([[1.0, 0.0, 500_000 - SIDE / 2], [0.0, -1.0, 5_250_000 + SIDE / 2]])
    return Scene(pixels, (HOME_M + slope * east_m).astype(np.float32), T, "EPSG:32632")


@pytest.mark.parametrize(("scenario", "slope"), [("jam", 0.5), ("map_edge", 0.5), ("jam", -0.5)])
def test_a_way_that_leads_into_a_hillside_is_refused(scenario: str, slope: float) -> None:
    """It was flown, the camera 50 m under ground, and what it then saw counted against the daemon."""
    home = GeoPoint(*map_crs("EPSG:32632").to_geo(500_000.0, 5_250_000.0), HOME_M)
    scene = hillside(slope)
    area = FlightArea(home, scene.reach_m(home), 1.0)
    setup = FlightSetup(SCENARIOS[scenario], area, AutopilotKind.ARDUPILOT, "copter", 1, width_px=64)
    if scenario == "map_edge":  # to the north: along the slope
        assert simulated_camera(setup, scene)
        return
    with pytest.raises(MapError, match=r"rises to (19|20)\d m above its middle below a way that is flown 150 m above it; remedy"):
        simulated_camera(setup, scene)
    assert simulated_camera(setup, hillside(slope / 2)).model == setup.camera_model()
