"""The camera in the vehicle: when its frames are taken, where it looks, its lens, and what is wrong with it."""
