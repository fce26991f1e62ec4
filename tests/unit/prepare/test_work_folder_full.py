"""Work that cannot begin, as the disk is full to the last byte: one clear error, and nothing is left behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import resource, sys
from pathlib import Path
from visloc_companion.errors import MapError
from visloc_companion.prepare.work_folder import WorkFolder

resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))  # what a full disk does to every write
try:
    WorkFolder(Path(sys.argv[1]), "key")
except MapError as why:
    print(why)
"""


def test_a_disk_without_room_for_the_first_line_is_told(tmp_path: Path) -> None:
    """Closing the log failed as writing it had, and the build ended in a traceback with exit code 1."""
    ended = subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path / "pack")], capture_output=True, text=True, check=False)
    assert ended.stderr == ""
    assert "pack: no folder can be made there: " in ended.stdout
    assert "remedy: name a place that can be written to" in ended.stdout
    assert not list(tmp_path.iterdir())
