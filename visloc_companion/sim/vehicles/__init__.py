"""True motion of copter and plane, and the sensors that they carry."""
