"""The one place where sections of the configuration become adapters (link: app/link.py, cameras: adapters/camera/factory.py).

What they need is imported when they are made: the worker's process, which takes longest, starts before that (app/parts.py).
"""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.app.handover import Left
from visloc_companion.app.parts import Constructors
from visloc_companion.config import Config
from visloc_companion.protocols import AutopilotLink, Camera, Clock


def make_link(
    config: Config,
    clock: Clock,
    on_raw: Callable[[bytes, int, bool], None],
    on_warning: Callable[[str], None],
    left: Left | None = None,
) -> AutopilotLink:
    """The MAVLink connection of a configuration. Raises ConfigError or MapError (app/link.py)."""
    from visloc_companion.app.link import make_link as make

    return make(config, clock, on_raw, on_warning, left)


def make_camera(config: Config, clock: Clock) -> Camera:
    """The camera of a configuration. Raises ConfigError for an unknown kind, CameraError where it cannot be used."""
    from visloc_companion.adapters.camera.factory import make_camera as make

    return make(config.camera, clock)


CONSTRUCTORS = Constructors(link=make_link, camera=make_camera)
