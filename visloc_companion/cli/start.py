"""Where the `visloc` command begins.

The daemon's worker process imports again what its parent began with: this module, and nothing of the command line.
"""

from __future__ import annotations

import sys

_ENDED_BY_CTRL_C = 130
"""As the commands themselves end then: 128 + SIGINT."""


def main() -> None:
    """Run the command line (cli/main.py). Ctrl-C while it is still being loaded, or put together, ends it without a traceback."""
    try:
        from visloc_companion.cli.main import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(_ENDED_BY_CTRL_C)
