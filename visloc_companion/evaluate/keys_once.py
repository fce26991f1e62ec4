"""JSON that people write: of a key that is there twice in an object Python would keep the last value."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any


def loads_keys_once(text: str) -> Any:
    """What a JSON text holds. Raises ValueError where it is none or has a key twice in an object, as json.loads else."""
    return json.loads(text, object_pairs_hook=_each_once)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    twice = [key for key, n in Counter(key for key, _ in pairs).items() if n > 1]
    if twice:
        raise ValueError(f"{', '.join(map(repr, twice))} twice in one entry, {dict(pairs)!r:.80}")
    return dict(pairs)
