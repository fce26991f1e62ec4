"""What flies without the structure vote does not load what only the vote needs."""

import subprocess
import sys

FLY_WITHOUT_THE_VOTE = """
import sys
from visloc_companion.localise.flight import flight_localiser
from visloc_companion.types import CameraModel
model = CameraModel(64, 48, 100.0, 100.0, 31.5, 23.5)
limits = {"max_probability_wrong": 0.05, "max_search_radius_m": 100.0, "threads": 1}
flight_localiser("gradient", model, None, **limits, structure=False)
print("visloc_companion.localise.registration.height_search" in sys.modules)
flight_localiser("gradient", model, None, **limits, structure=True)
print("visloc_companion.localise.registration.height_search" in sys.modules)
"""


def test_the_registration_is_loaded_for_the_structure_vote_only() -> None:
    done = subprocess.run([sys.executable, "-c", FLY_WITHOUT_THE_VOTE], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
