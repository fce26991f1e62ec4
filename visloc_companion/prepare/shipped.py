"""The network whose features packs hold unless told otherwise: the one that came with this version."""

from __future__ import annotations

import os

from visloc_companion.errors import ConfigError, ModelError
from visloc_companion.localise.features.base import Features


def shipped_networks() -> tuple[tuple[Features, ...], str]:
    """The network, opened on all cores, or none and why: it did not come along, is changed, or onnxruntime is not installed."""
    from visloc_companion.localise.features.onnx import open_features

    try:
        return (open_features(threads=len(os.sched_getaffinity(0))),), ""
    except (ModelError, ConfigError) as why:
        return (), str(why)
