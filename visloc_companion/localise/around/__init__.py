"""Localisers that ask another one: about a frame that they have changed, or to add to its answer."""
