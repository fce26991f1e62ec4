"""`visloc doctor`: says why external positions would not be used, before the flight, and what to change."""
