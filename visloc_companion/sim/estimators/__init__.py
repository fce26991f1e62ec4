"""The built-in autopilot's position filter, as ArduPilot's EKF3 and as PX4's EKF2."""
