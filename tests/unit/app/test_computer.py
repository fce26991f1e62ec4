"""The computer's load, from files as Linux writes them."""

import resource
from pathlib import Path

import pytest

from visloc_companion.app.computer import Computer


@pytest.fixture
def root(tmp_path: Path) -> Path:
    zones = tmp_path / "sys/class/thermal"
    (tmp_path / "proc").mkdir()
    for i, text in enumerate(["48500\n", "61250\n", "-273000\n", "not connected\n"]):
        (zones / f"thermal_zone{i}").mkdir(parents=True)
        (zones / f"thermal_zone{i}/temp").write_text(text)
    (tmp_path / "proc/uptime").write_text("4321.09 8000.00\n")
    (tmp_path / "proc/meminfo").write_text("MemTotal:        4000000 kB\nMemFree:   1 kB\nMemAvailable:    1000000 kB\n")
    write_stat(tmp_path, (100, 0, 100, 700, 100, 0, 0, 0, 9, 9), (0, 0, 0, 1000, 0, 0, 0, 0, 0, 0))
    return tmp_path


def write_stat(root: Path, *cores: tuple[int, ...]) -> None:
    lines = [f"cpu{i} {' '.join(map(str, core))}" for i, core in enumerate(cores)]
    (root / "proc/stat").write_text("\n".join(["cpu  1 2 3 4 5 6 7 8 9 10", *lines, "intr 5 0 1", "ctxt 7"]))


def test_what_linux_tells(root: Path) -> None:
    load = Computer(root, root).look()
    assert (load.uptime_s, load.temperature_c) == (4321.09, 61.25)
    assert (load.ram_used_bytes, load.ram_total_bytes) == (3_000_000 * 1024, 4_000_000 * 1024)
    assert load.cores == pytest.approx((0.2, 0.0))
    assert load.storage_total_bytes is not None
    assert load.storage_used_bytes is not None
    assert 0 < load.storage_used_bytes <= load.storage_total_bytes


def test_the_share_is_since_the_last_look(root: Path) -> None:
    computer = Computer(root, root)
    computer.look()
    write_stat(root, (150, 0, 125, 715, 110, 0, 0, 0, 9, 9), (0, 0, 0, 1000, 0, 0, 0, 0, 0, 0))
    assert computer.look().cores == pytest.approx((0.75, 0.0))


def test_a_system_that_tells_nothing(tmp_path: Path) -> None:
    load = Computer(tmp_path / "absent", tmp_path).look()
    assert (load.uptime_s, load.cores, load.temperature_c, load.ram_used_bytes) == (None, (), None, None)
    assert (load.storage_used_bytes, load.storage_total_bytes) == (None, None)


def test_this_system_can_be_looked_at() -> None:
    load = Computer(Path("/")).look()
    assert all(0.0 <= share <= 1.0 for share in load.cores)


def test_without_a_descriptor_left_it_tells_less(root: Path) -> None:
    """The look at the thermal zones ended the daemon in flight."""
    computer, (soft, hard) = Computer(root, root), resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        load = computer.look()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert (load.temperature_c, load.ram_total_bytes, load.cores) == (None, None, ())
    assert computer.look().temperature_c is not None
