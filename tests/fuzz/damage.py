"""What may happen to the bytes of a file."""

from __future__ import annotations

from hypothesis import strategies as st

KINDS = ("flip", "cut", "extend", "swap")


def damaged(raw: bytes, data: st.DataObject, kind: str, most_added: int, most_swapped: int) -> bytes:
    """The bytes with one bit flipped, cut off, with at most so many added, or with at most so many exchanged."""
    at = data.draw(st.integers(0, len(raw) - 1))
    if kind == "flip":
        return raw[:at] + bytes([raw[at] ^ (1 << data.draw(st.integers(0, 7)))]) + raw[at + 1 :]
    if kind == "cut":
        return raw[:at]
    if kind == "extend":
        return raw + data.draw(st.binary(min_size=1, max_size=most_added))
    part = data.draw(st.binary(min_size=1, max_size=most_swapped))
    return raw[:at] + part + raw[at + len(part) :]
