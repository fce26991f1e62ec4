"""MAVLink: codec, pymavlink link, time, parameters."""
