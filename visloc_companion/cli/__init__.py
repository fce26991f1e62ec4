"""The visloc command."""
