"""Everything that `visloc run` needs, tried before the flight without starting it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.computer import serial_device, serial_problem
from visloc_companion.app.constructors import CONSTRUCTORS
from visloc_companion.app.ground_check import open_pack
from visloc_companion.app.link_address import check_address
from visloc_companion.app.parts import (
    Constructors,
    check_calibration,
    check_journal_folder,
    journal_header,
    require_lens,
    require_pack,
)
from visloc_companion.app.status import check_status_socket
from visloc_companion.app.versions import versions
from visloc_companion.app.worker_process import about_of, load_factory
from visloc_companion.config import Config
from visloc_companion.errors import LinkError, VislocError


def preflight(config: Config, make: Constructors = CONSTRUCTORS) -> tuple[list[VislocError], dict[str, Any]]:
    """All problems of link, camera, calibration, map, localiser, journal and status socket, and what was found."""
    problems: list[VislocError] = []
    clock = MonotonicClock()
    about = ""

    def attempt(check: Callable[[], object]) -> None:
        try:
            check()
        except VislocError as problem:
            if str(problem) not in map(str, problems):  # a lens that cannot be is found by camera and localiser
                problems.append(problem)

    def open_worker() -> None:
        nonlocal about
        if require_pack(config):
            about = about_of(load_factory(make.answers)(config))

    def open_camera() -> None:
        camera = make.camera(config, clock)
        attempt(lambda: check_calibration(config, camera))
        attempt(lambda: require_lens(config))

    def doubt(text: str) -> None:
        """Of the link before it is opened: what a start goes on with, as in flight it must, and a check does not."""
        problems.append(LinkError(text, where="link"))

    attempt(lambda: make.link(config, clock, lambda *_: None, doubt, None))
    attempt(lambda: check_address(config.link.url))
    attempt(lambda: check_serial_device(config.link.url))
    if config.camera.url:
        attempt(open_camera)
    if config.camera.url or config.localiser.terrain:
        attempt(open_worker)
    elif config.map.pack:  # held against GNSS on the ground
        attempt(lambda: open_pack(config, verify_hashes=config.map.verify_hashes))
    if config.journal.folder:
        attempt(lambda: check_journal_folder(config))
    if config.status.socket:
        attempt(lambda: check_status_socket(Path(config.status.socket)))
    header = journal_header(config, clock.now_ns())
    found = {
        "versions": versions(),
        "map_manifest_sha256": header.map_manifest_sha256,
        "map_signed_by": header.map_signed_by,
        "localiser": about,
    }
    return problems, found


def check_serial_device(url: str) -> None:
    """The daemon waits for a serial device that is not there, as a cable may come later; before a flight it is missed.

    Raises LinkError.
    """
    device = serial_device(url)
    if device and (problem := serial_problem(device)):
        remedy = (
            "check the name (ls /dev/tty* /dev/serial/by-id), that the port is enabled, and the right to use it (group dialout)"
        )
        raise LinkError(problem, where="link.url", remedy=remedy)
