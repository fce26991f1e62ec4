"""Evidence for and against GNSS: receivers, clock, height, odometry, and vision as a sequential test."""
