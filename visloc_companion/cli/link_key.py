"""`visloc link-key`: a key for MAVLink signing."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def link_key(out: Annotated[Path, typer.Option("--out", help="The new file; only its owner may read it.")]) -> None:
    """Make a file with a random passphrase for link.signing_key_file (docs/safety.md says how the autopilot gets the key)."""
    from visloc_companion.adapters.mavlink.signing_key import write_key

    write_key(out)
    sys.stdout.write(
        f"{out} holds the passphrase. Set link.signing_key_file to it, let it belong to the user that visloc runs as,\n"
        "and enter the same passphrase for signing in the ground station, which gives the key to the autopilot.\n"
    )
