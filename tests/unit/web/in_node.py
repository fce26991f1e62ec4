"""Runs the page's modules in Node, without a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib import resources
from typing import Any

import pytest

NODE = shutil.which("node")


def printed(script: str, module: str) -> Any:
    """What a script prints as JSON, whose %s is the address of a module of the page; skips where Node is not installed."""
    if NODE is None:
        pytest.skip("Node is not installed")
    whole = script.replace("%s", f"file://{resources.files('visloc_companion.web') / 'page' / module}")
    done = subprocess.run([NODE, "--input-type=module", "-e", whole], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
