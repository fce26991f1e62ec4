"""Parts of frame-to-frame odometry (localise/flow.py): what it is given, the picture, the ground, the tracks, the solution."""
