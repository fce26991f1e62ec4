"""Where the `visloc` command begins.

The daemon's worker process imports again what its parent began with: this module, and nothing of the command line.
"""

from __future__ import annotations


def main() -> None:
    """Run the command line (cli/main.py)."""
    from visloc_companion.cli.main import main as run

    run()
