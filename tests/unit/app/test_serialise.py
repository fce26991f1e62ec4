"""Every event and command survives JSON bit for bit."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import fields
from enum import StrEnum
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visloc_companion import types
from visloc_companion.app.serialise import COMMAND_TYPES, EVENT_TYPES, TYPES, from_dict, from_json, json_schema, to_json
from visloc_companion.errors import JournalError
from visloc_companion.types import (
    Attitude,
    GeoPoint,
    Gnss,
    Injection,
    Mode,
    Notice,
    OriginChanged,
    PosePrior,
    Severity,
    Status,
    Tick,
    Verdict,
)


def strategy(hint: Any) -> st.SearchStrategy[Any]:
    """All values of an annotated type."""
    simple = {
        int: st.integers(-(2**63), 2**63 - 1),
        float: st.floats(allow_nan=True, allow_infinity=True),
        bool: st.booleans(),
        str: st.text(max_size=8),
        type(None): st.none(),
    }
    if hint in simple:
        return simple[hint]
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return st.sampled_from(list(hint))
    if get_origin(hint) is tuple:
        first, *rest = get_args(hint)
        if rest == [Ellipsis]:
            return st.lists(strategy(first), max_size=3).map(tuple)
        return st.tuples(strategy(first), *map(strategy, rest))
    if get_args(hint):
        return st.one_of(*map(strategy, get_args(hint)))
    hints = get_type_hints(hint)
    return st.builds(hint, **{item.name: strategy(hints[item.name]) for item in fields(hint)})


def exact(value: Any) -> Any:
    """The value with floats as their bits, so that NaN, -0.0 and 1 against 1.0 compare."""
    if isinstance(value, float):
        return ("float", struct.pack("<d", value) if not math.isnan(value) else "nan")
    if isinstance(value, (tuple, list)):
        return tuple(exact(part) for part in value)
    if hasattr(value, "__dataclass_fields__"):
        return (type(value).__name__, *(exact(getattr(value, item.name)) for item in fields(value)))
    return (type(value).__name__, value)


@pytest.mark.parametrize("name", sorted(TYPES))
def test_round_trip_of_every_type(name: str) -> None:
    @settings(max_examples=25)
    @given(strategy(TYPES[name]))
    def check(thing: Any) -> None:
        text = to_json(thing)
        assert exact(from_json(text)) == exact(thing)
        assert to_json(from_json(text)) == text
        assert json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))["type"] == name

    check()


def test_every_event_and_command_has_a_name_of_its_own() -> None:
    assert len(TYPES) == len(EVENT_TYPES) + len(COMMAND_TYPES) == len(get_args(types.Event)) + len(get_args(types.Command))


@pytest.mark.parametrize("name", sorted(TYPES))
def test_the_schema_names_exactly_the_fields(name: str) -> None:
    schema = json_schema(TYPES[name])
    assert list(schema["properties"]) == ["type", *(item.name for item in fields(TYPES[name]))]
    assert schema["title"] == schema["properties"]["type"]["const"] == name
    json.dumps(schema, allow_nan=False)


def test_numpy_scalars_become_plain_numbers() -> None:
    event = Attitude(np.int64(3), 4, (np.float64(1.0), np.float32(0.5), 0.0, 0.0), (0.1, 0.2, 0.3))  # type: ignore[arg-type]
    back = from_json(to_json(event))
    assert back == event
    assert isinstance(back, Attitude)
    assert type(back.t_rx_ns) is int
    assert type(back.q_ned_frd[0]) is float


def test_text_nan_and_number_nan_stay_apart() -> None:
    notice = Notice(Severity.INFO, "x", data=(("a", "nan"), ("b", math.nan), ("c", math.inf), ("d", "é\n\u2028\udc80")))
    back = from_json(to_json(notice))
    assert isinstance(back, Notice)
    assert back.data[0] == ("a", "nan")
    assert math.isnan(float(back.data[1][1]))
    assert back.data[2:] == (("c", math.inf), ("d", "é\n\u2028\udc80"))


ODD = (None, True, False, 0, 7, 1.0, -2.5, 1e999, "", "inf", [], [1.0], [1, 2.0], {}, {"float": "nan"}, {"lat_deg": 1.0})


def judged(data: dict[str, Any]) -> Any:
    """What is made of an object: a thing, or why it is none."""
    try:
        return exact(from_dict(data))
    except JournalError as why:
        return why.what


@pytest.mark.parametrize("name", sorted(TYPES))
def test_what_a_field_holds_is_judged_the_same_whatever_the_order_of_fields(name: str) -> None:
    """In the order in which they were written fields need no names, and most of them no look."""

    @settings(max_examples=10)
    @given(strategy(TYPES[name]), st.data())
    def check(thing: Any, data: st.DataObject) -> None:
        written = json.loads(to_json(thing))
        if len(written) > 1:
            written[data.draw(st.sampled_from(list(written)[1:]))] = data.draw(st.sampled_from(ODD))
        kind, *others = written.items()
        moved = data.draw(st.sampled_from(range(len(others)))) if others else 0
        assert judged(dict(written)) == judged(dict([kind, *others[moved:], *others[:moved]]))

    check()


def test_a_text_is_no_array_of_texts() -> None:
    status = Status(1, Mode.LOST, Verdict.OK, (), None, (0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, None, None, False, 0)
    written = json.loads(to_json(status))
    with pytest.raises(JournalError, match="'jam' is not an array"):
        from_dict({**written, "reasons": "jam"})


def test_a_field_that_came_later_takes_its_default() -> None:
    text = to_json(Gnss(1, 2, 3, None, GeoPoint(1.0, 2.0, 3.0), None, 2.5, None)).replace(',"receiver":0', "")
    assert "receiver" not in text
    assert from_json(text) == Gnss(1, 2, 3, None, GeoPoint(1.0, 2.0, 3.0), None, 2.5, None)


@pytest.mark.parametrize("numbers", [(1.0, 2.5, -3.0), (1e308, 1e308, 1e308), (1, 2.0, 3), (math.inf, -math.inf, math.nan)])
def test_numbers_come_back_as_they_were_whatever_their_sum(numbers: tuple[float, float, float]) -> None:
    back = from_json(to_json(Attitude(1, 2, (1.0, 0.0, 0.0, 0.0), numbers)))
    assert repr(back) == repr(Attitude(1, 2, (1.0, 0.0, 0.0, 0.0), numbers))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ('{"type":"Tick","t_rx_ns":NaN}', "NaN is not JSON"),
        ("[]", "unknown type None"),
        ('{"type":["Tick"]}', "unknown type"),
        ('{"type":"Tock"}', "unknown type 'Tock'"),
        ('{"type":"Tick"}', "missing fields"),
        ('{"type":"Tick","t_rx_ns":1,"x":2}', "unknown fields"),
        ('{"type":"Tick","t_rx_ns":1.5}', "not of type int"),
        ('{"type":"Tick","t_rx_ns":true}', "not of type int"),
        ('{"type":"OriginChanged","t_rx_ns":1,"origin":{"lat_deg":1e999,"lon_deg":0,"h_amsl_m":0}}', "too large"),
        ('{"type":"OriginChanged","t_rx_ns":1,"origin":{"lat_deg":"1","lon_deg":0,"h_amsl_m":0}}', "not a number"),
        ('{"type":"OriginChanged","t_rx_ns":1,"origin":[1,2,3]}', "not of type dict"),
        ('{"type":"Attitude","t_rx_ns":1,"t_boot_ns":1,"q_ned_frd":[1,0,0],"rate_frd_radps":[0,0,0]}', "Attitude cannot be read"),
        ('{"type":"Attitude","t_rx_ns":1,"t_boot_ns":1,"q_ned_frd":7,"rate_frd_radps":[0,0,0]}', "not an array"),
        ('{"type":"Attitude","t_rx_ns":1,"t_boot_ns":1,"q_ned_frd":[1.0,0.0,0.0,1e999],"rate_frd_radps":[0,0,0]}', "too large"),
        ('{"type":"Attitude","t_rx_ns":1,"t_boot_ns":1,"q_ned_frd":[1.0,0.0,0.0,true],"rate_frd_radps":[0,0,0]}', "not a number"),
        ('{"type":"SwitchSource","source":"astrology"}', "SwitchSource cannot be read"),
    ],
)
def test_what_cannot_be_read_says_why(text: str, what: str) -> None:
    with pytest.raises(JournalError, match=what):
        from_json(text)


@pytest.mark.parametrize(
    "thing",
    [
        Tick(1.5),  # type: ignore[arg-type]
        Notice(Severity.INFO, 7),  # type: ignore[arg-type]
        Notice("loud", "text"),  # type: ignore[arg-type]
        OriginChanged(1, None),  # type: ignore[arg-type]
        OriginChanged(1, GeoPoint(True, "x", 0.0)),  # type: ignore[arg-type]
        Injection(1, (1.0, 2.0), GeoPoint(0, 0, 0), (1, 0, 0, 0), ((1, 0), (0, 1)), 1, 1, 0),  # type: ignore[arg-type]
        PosePrior(GeoPoint(0, 0, 0), (1, 0, 0, 0), ((1, 0), (0, 1)), 1, 1, 1),
    ],
)
def test_what_cannot_be_written_is_refused(thing: Any) -> None:
    with pytest.raises(JournalError):
        to_json(thing)
