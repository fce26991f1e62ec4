"""Numbers in one text, as options and tables of cases have them."""

from __future__ import annotations

import re

_BETWEEN = re.compile(r"\s*,\s*|\s+")


def number_texts(text: str) -> list[str]:
    """What stands between commas or blanks; empty where a comma has nothing beside it, none in a blank text."""
    return _BETWEEN.split(text.strip()) if text.strip() else []
