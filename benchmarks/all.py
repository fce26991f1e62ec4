"""All benchmarks one after the other: `python -m benchmarks.all` (about an hour on two cores)."""

from __future__ import annotations

import subprocess
import sys
import tempfile

from benchmarks.cases import SHARED


def main() -> None:
    """Run each as a process of its own; ends with the first failure's code."""
    steps = [["speed"], ["landscape"], ["flights"]]
    if SHARED.is_dir():
        steps.append(["naip", tempfile.mkdtemp(prefix="visloc-naip-"), "--jobs", "2", "--photos"])
    for step in steps:
        print(f"\n## {step[0]}\n", flush=True)
        subprocess.run([sys.executable, "-m", f"benchmarks.{step[0]}", *step[1:]], check=True)


if __name__ == "__main__":
    main()
