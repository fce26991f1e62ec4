"""The built-in autopilot beside its filter: control, modes, parameters, and what it says and takes over MAVLink."""
