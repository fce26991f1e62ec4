"""`visloc demo`: the daemon and the built-in autopilot as processes of their own, judged."""
