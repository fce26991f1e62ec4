"""From a scene to a picture: rays, lens, air, sensor, motion, water."""
