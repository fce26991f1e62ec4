"""The benchmarks of speed, matching and flights one after the other: `python -m benchmarks.all` (several hours on two cores)."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile

from benchmarks.image_cases.cases import SHARED


def main() -> None:
    """Run each as a process of its own; ends with the first failure's code."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    steps = [["speed"], ["navigator"], ["height"], ["landscape"], ["flights"]]
    if SHARED.is_dir():
        folder = tempfile.mkdtemp(prefix="visloc-cases-")
        steps += [["table", folder, "--jobs", "2", "--breakdown"], ["floor", folder, "--jobs", "2"]]
        steps += [["cross_view", folder, "--jobs", "2"]]
        steps += [["joint", "--n", "60"], ["joint", "--n", "60", "--method", "deep"]]
    for step in steps:
        print(f"\n## {step[0]}\n", flush=True)
        subprocess.run([sys.executable, "-m", f"benchmarks.{step[0]}", *step[1:]], check=True)


if __name__ == "__main__":
    main()
