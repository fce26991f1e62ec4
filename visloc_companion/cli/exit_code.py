"""Exit codes of the `visloc` command for errors."""

from __future__ import annotations

from visloc_companion.errors import ConfigError, LinkError, VislocError, is_of_the_disk


def exit_code(error: VislocError) -> int:
    """The process exit code that tells what kind of thing went wrong: 2 is what does not get better by trying again."""
    if isinstance(error, ConfigError) and not is_of_the_disk(error.__cause__):
        return 2
    return 4 if isinstance(error, LinkError) else 3
