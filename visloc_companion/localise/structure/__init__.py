"""Motion stereo: a local cloud from overlapping frames of a down-looking camera, and the camera's pose from where it lies."""
