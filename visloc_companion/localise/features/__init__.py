"""Dense features of images."""
