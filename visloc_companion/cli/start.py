"""Where the `visloc` command begins.

The daemon's worker process imports again what its parent began with: this module, and nothing of the command line.
"""

from __future__ import annotations

import sys

from visloc_companion.cli.ctrl_c import ENDED_BY_CTRL_C, ends_at_once


def main() -> None:
    """Run the command line (cli/main.py). Ctrl-C while it is still being loaded, or put together, ends it without a traceback."""
    try:
        with ends_at_once():
            from visloc_companion.cli.main import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(ENDED_BY_CTRL_C)
