"""A configuration as TOML."""

from __future__ import annotations

import tomllib
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.cli.toml import to_toml
from visloc_companion.config import Config, parse_config

PLAIN = st.one_of(
    st.text(st.characters(exclude_categories=("Cs",), max_codepoint=0xFFFF)),
    st.integers(-(2**63), 2**63 - 1),
    st.booleans(),
    st.floats(allow_nan=False, allow_infinity=False),
)
NAMES = st.from_regex(r"[a-z_]{1,8}", fullmatch=True)


@given(st.dictionaries(NAMES, PLAIN | st.lists(PLAIN, max_size=3) | st.dictionaries(NAMES, PLAIN, max_size=3), max_size=5))
def test_what_is_written_is_what_is_read(data: dict[str, Any]) -> None:
    assert tomllib.loads(to_toml(data)) == data


def test_the_default_configuration_comes_back() -> None:
    text = to_toml(Config().model_dump(mode="json"))
    assert parse_config(tomllib.loads(text)) == Config()
    assert "[link]\nurl = " in text
