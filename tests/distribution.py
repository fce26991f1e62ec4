"""Which of pytest-xdist's processes runs which test, and in what order (`--dist loadfile`).

pytest-xdist 3.8 cannot read its groups under pytest 9.2: tests that shared a flight were dealt out like cards, and each process
flew it again. Here the tests of a file go to one process, with what its fixtures make. Those of the files in APART are long and
share no more than a world that is kept on disk: they go one by one, before all others, so that none is left over at the end.
"""

from __future__ import annotations

from pathlib import PurePath

import pytest
from xdist.remote import Producer
from xdist.scheduler.loadscope import LoadScopeScheduling

APART = (
    "tests/unit/evaluate/test_scenarios_seen.py",
    "tests/unit/evaluate/test_closed_loop.py",
    "tests/unit/evaluate/test_closed_loop_pictures.py",
    "tests/statistics/test_filter_consistency.py",
)
LONG = (
    "tests/unit/localise/structure/test_localiser.py",
    "tests/unit/core/test_aimed_flight.py",
    "tests/unit/core/camera/test_distortion_watch.py",
    "tests/unit/localise/test_ranged.py",
    "tests/unit/localise/around/test_rectified.py",
    "tests/unit/cli/test_sim.py",
    "tests/unit/doctor/test_examination.py",
    "tests/unit/evaluate/test_campaign.py",
    "tests/unit/cli/test_replay_again.py",
    "tests/unit/sim/test_terrain_flight.py",
    "tests/unit/cli/test_sim_ended.py",
    "tests/unit/localise/around/test_with_motion.py",
    "tests/unit/localise/test_keypoint.py",
    "tests/unit/localise/test_registry.py",
    "tests/unit/evaluate/demonstration/test_demo.py",
    "tests/unit/app/test_daemon_process.py",
    "tests/statistics/test_combined_faults.py",
    "tests/replay/test_real_logs.py",
)
"""Next, as their tests take fifteen seconds and more together: those of more than eight seconds each (`--durations` of all tests,
three processes on two cores), or all of them (CPU of a package alone); beyond, the order is pytest-randomly's."""


class FilesTogether(LoadScopeScheduling):
    """A unit of work is a file, or one test of a file in APART; in the order in which they were collected."""

    def __init__(self, config: pytest.Config, log: Producer | None = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False  # by the number of tests, which says little about how long they take

    def _split_scope(self, nodeid: str) -> str:
        file = file_of(nodeid)
        return nodeid if file in APART else file


def long_ones_first(items: list[pytest.Item]) -> None:
    """Sort what was collected: files in APART, then those in LONG, then the others, each in the order that they had."""
    order = {file: place for place, file in enumerate((*APART, *LONG))}
    items.sort(key=lambda item: order.get(file_of(item.nodeid), len(order)))


def file_of(nodeid: str) -> str:
    """Its file, from the project's root on, with slashes."""
    return PurePath(nodeid.split("::", 1)[0]).as_posix()
