"""How high the vehicle is: above its home, where it took off, and the autopilot's height against fixes."""
