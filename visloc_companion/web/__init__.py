"""The dashboard (`visloc web`): a process of its own that shows on a page what the daemon's status socket says."""
