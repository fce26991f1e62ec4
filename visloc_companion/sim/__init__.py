"""Simulation as product code: landscape, camera, vehicle, autopilot, scenarios."""
