"""visloc-companion: keeps a drone knowing where it is when satellite navigation is jammed, spoofed or lost.

Read in this order: types/, protocols.py, core/navigator.py, app/live.py, app/replay.py.
"""

__version__ = "0.1.0"
