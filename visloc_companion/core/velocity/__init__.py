"""Velocities that drive the filter, and how far each is to be believed: the autopilot's, inertial, of drag, of a pitot tube."""
