"""What a journal says of the computer that flew."""

import platform
from pathlib import Path

import numpy
import pytest

from visloc_companion.app.versions import processor, versions


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("processor\t: 0\nmodel name\t: AMD EPYC 7763\nflags\t: sse\n\nprocessor\t: 1\nmodel name\t: other\n", "AMD EPYC 7763"),
        ("processor\t: 0\nCPU implementer\t: 0x41\nCPU architecture: 8\nCPU part\t: 0xd0b\n\nCPU part\t: 0xd05\n", "0x41 0xd0b"),
        ("Hardware: something\n", "not known"),
    ],
)
def test_the_first_processor_is_named(text: str, name: str, tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc/cpuinfo").write_text(text)
    assert processor(tmp_path) == name


def test_no_processor_is_made_up_where_nothing_tells(tmp_path: Path) -> None:
    assert processor(tmp_path) == "not known"


def test_versions_name_what_computes() -> None:
    found = versions()
    assert (found["numpy"], found["python"], found["machine"]) == (
        numpy.__version__,
        platform.python_version(),
        platform.machine(),
    )
    assert found["libc"].startswith("glibc ") or "gnu" not in platform.platform()
