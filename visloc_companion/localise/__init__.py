"""Localisers, synchronous: a frame and a reference map in, a pose or a reason out."""
