"""Events and commands as JSON and back, exactly: floats bit for bit, enumerations by value, tuples as arrays, None as null.

What is written is strict JSON (RFC 8259). It has no infinity and no NaN, so those travel as {"float": "inf"}. Every object
names its type, so a text can be read without knowing where it came from.
"""

from __future__ import annotations

import json
import math
import operator
import types as python_types
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

from visloc_companion.errors import JournalError
from visloc_companion.types import Command, Event

EVENT_TYPES: dict[str, type] = {kind.__name__: kind for kind in get_args(Event)}
COMMAND_TYPES: dict[str, type] = {kind.__name__: kind for kind in get_args(Command)}
TYPES: dict[str, type] = EVENT_TYPES | COMMAND_TYPES

_SIMPLE_SCHEMAS: dict[Any, Any] = {
    float: ["number", "object"],
    int: "integer",
    bool: "boolean",
    str: "string",
    float | str: ["number", "object", "string"],
}
_Convert = Callable[[Any], Any]
_STAY = (int, bool, str, type(None))
_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


def to_json(thing: Event | Command) -> str:
    """One line of JSON. Raises JournalError for a type that is no event or command, or a value that its field cannot hold."""
    name = type(thing).__name__
    if TYPES.get(name) is not type(thing):
        raise JournalError(f"{name} is neither an event nor a command", remedy="journal only members of types.Event and Command")
    try:
        kind: Any = type(thing)
        return _ENCODE({"type": name, **_encoder(kind)(thing)})
    except (TypeError, ValueError, AttributeError) as why:
        raise JournalError(f"{name} cannot be written: {why}", where=repr(thing)) from why


def from_json(text: str | bytes) -> Event | Command:
    """The event or command of one line of JSON. Raises JournalError naming what is wrong with it."""
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as why:
        raise JournalError(f"is not JSON: {why}", where=repr(text[:80])) from why
    return from_dict(data)


def from_dict(data: Any) -> Event | Command:
    """As `from_json`, of a parsed object, whose "type" is taken out of it."""
    name = data.pop("type", None) if isinstance(data, dict) else None
    kind = TYPES.get(name) if isinstance(name, str) else None
    if kind is None:
        raise JournalError(f"unknown type {name!r}", remedy="read the journal with the version that wrote it")
    try:
        thing: Event | Command = _decoder(kind)(data)
    except (TypeError, ValueError, OverflowError) as why:
        raise JournalError(f"{name} cannot be read: {why}", remedy="read the journal with the version that wrote it") from why
    return thing


def json_schema(kind: type) -> dict[str, Any]:
    """JSON Schema of what `to_json` writes for an event or command type."""
    schema = _schema(kind)
    schema["properties"] = {"type": {"const": kind.__name__}, **schema["properties"]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": kind.__name__, **schema}


def _hints(kind: type) -> Iterator[tuple[str, Any, bool]]:
    """(name, type, required) of the fields of a dataclass."""
    hints = get_type_hints(kind)
    for item in fields(kind):
        yield item.name, hints[item.name], item.default is MISSING and item.default_factory is MISSING


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


# --------------------------------------------------------------------------------------------------------------- writing


@cache
def _encoder(kind: Any) -> _Convert:
    """Function from a value of the annotated type to what json can write."""
    if kind in _SIMPLE_ENCODERS:
        return _SIMPLE_ENCODERS[kind]
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return lambda value: kind(value).value
    if is_dataclass(kind):
        parts = [(name, _encoder(hint)) for name, hint, _ in _hints(kind)]  # type: ignore[arg-type]
        return lambda value: {name: encode(getattr(value, name)) for name, encode in parts}
    if get_origin(kind) is tuple:
        return _tuple_converter(kind, _encoder, list)
    (member,) = _union_members(kind)
    encode = _encoder(member)
    return lambda value: None if value is None else encode(value)


def _encode_float(value: Any) -> Any:
    if type(value) is float and math.isfinite(value):  # nearly all
        return value
    if isinstance(value, (bool, str)):
        raise TypeError(f"{value!r} is not a number")
    if type(value) is int:
        return value
    number = float(value)  # numpy scalars of any width too
    return number if math.isfinite(number) else {"float": repr(number)}


def _encode_text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not a text")
    return str(value)


_SIMPLE_ENCODERS: dict[Any, _Convert] = {
    float: _encode_float,
    int: operator.index,  # numpy integers too, never a float
    bool: bool,
    str: _encode_text,
    float | str: lambda value: _encode_text(value) if isinstance(value, str) else _encode_float(value),
}


# --------------------------------------------------------------------------------------------------------------- reading


@cache
def _decoder(kind: Any) -> _Convert:
    """Function from what json read to a value of the annotated type; raises TypeError or ValueError where it does not fit."""
    if kind in _SIMPLE_DECODERS:
        return _SIMPLE_DECODERS[kind]
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return lambda value: kind(_exactly(str, value))
    if is_dataclass(kind):
        return _dataclass_decoder(kind)
    if get_origin(kind) is tuple:
        one_by_one = _tuple_converter(kind, _decoder, tuple)
        return _float_tuple_decoder(one_by_one, len(get_args(kind))) if set(get_args(kind)) == {float} else one_by_one
    (member,) = _union_members(kind)
    decode = _decoder(member)
    return lambda value: None if value is None else decode(value)


def _dataclass_decoder(kind: Any) -> _Convert:
    """Of objects: what was written has the very fields in their order, so that they need no names; which of them are to be
    converted depends on what json made of each, which is the same nearly always."""
    hints = list(_hints(kind))
    names, decoders = tuple(name for name, _, _ in hints), {name: _decoder(hint) for name, hint, _ in hints}
    in_order, required = tuple(decoders.values()), frozenset(name for name, _, required in hints if required)
    to_convert: dict[tuple[type, ...], list[tuple[int, _Convert]]] = {}

    def converted(read: tuple[type, ...]) -> list[tuple[int, _Convert]]:
        stays = [_stays_as_read(hint, of_part) for (_, hint, _), of_part in zip(hints, read, strict=True)]
        return [(k, convert) for k, convert in enumerate(in_order) if not stays[k]]

    def decode(value: Any) -> Any:
        if type(value) is dict and tuple(value) == names:
            parts = [*value.values()]
            read = tuple(map(type, parts))
            if read not in to_convert:
                to_convert[read] = converted(read)
            for k, convert in to_convert[read]:
                parts[k] = convert(parts[k])
            return kind(*parts)
        data = _exactly(dict, value)
        if unknown := data.keys() - decoders.keys():
            raise ValueError(f"unknown fields {sorted(unknown)}")
        if missing := required - data.keys():
            raise ValueError(f"missing fields {sorted(missing)}")
        return kind(**{name: decoders[name](part) for name, part in data.items()})

    return decode


def _stays_as_read(hint: Any, read: type) -> bool:
    """Whether json gives nothing of this type that a field of the annotated type cannot hold as it is: of a float it may."""
    may_be = (hint,) if get_origin(hint) is tuple else get_args(hint) or (hint,)
    return read in _STAY and read in may_be


def _float_tuple_decoder(one_by_one: _Convert, n: int) -> _Convert:
    """Of n numbers: most are plain floats, which need no look at each."""
    floats = [float] * n

    def decode(value: Any) -> Any:
        plain = type(value) is list and [*map(type, value)] == floats and math.isfinite(sum(value))
        return tuple(value) if plain else one_by_one(value)

    return decode


def _decode_float(value: Any) -> Any:
    if type(value) is float and math.isfinite(value):
        return value
    if isinstance(value, dict) and value.keys() == {"float"} and value["float"] in ("inf", "-inf", "nan"):
        return float(value["float"])
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is not a number")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("a number is too large")
    return value


def _decode_int(value: Any) -> Any:
    if type(value) is not int:
        raise TypeError(f"{value!r} is not of type int")
    return value


def _exactly(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{value!r} is not of type {kind.__name__}")
    return value


_SIMPLE_DECODERS: dict[Any, _Convert] = {
    float: _decode_float,
    int: _decode_int,
    bool: lambda value: _exactly(bool, value),
    str: lambda value: _exactly(str, value),
    float | str: lambda value: value if isinstance(value, str) else _decode_float(value),
}

# ----------------------------------------------------------------------------------------------------------------- shape


def _union_members(kind: Any) -> tuple[Any, ...]:
    if get_origin(kind) not in (Union, python_types.UnionType):
        raise TypeError(f"no JSON form for {kind!r}")
    return tuple(member for member in get_args(kind) if member is not type(None))


def _tuple_converter(kind: Any, converter: Callable[[Any], _Convert], collect: Callable[[Any], Any]) -> _Convert:
    arguments = get_args(kind)
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        convert = converter(arguments[0])
        return lambda value: collect([convert(part) for part in _sequence(value)])
    parts = [converter(argument) for argument in arguments]
    return lambda value: collect([convert(part) for convert, part in zip(parts, _sequence(value), strict=True)])


def _sequence(value: Any) -> Any:
    if not isinstance(value, (tuple, list)):
        raise TypeError(f"{value!r} is not an array")
    return value


def _schema(kind: Any) -> dict[str, Any]:
    if kind in _SIMPLE_SCHEMAS:
        return {"type": _SIMPLE_SCHEMAS[kind]}
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return {"type": "string", "enum": [member.value for member in kind]}
    if is_dataclass(kind):
        hints = list(_hints(kind))  # type: ignore[arg-type]
        properties = {name: _schema(hint) for name, hint, _ in hints}
        return {"type": "object", "properties": properties, "required": [name for name, _, required in hints if required]}
    if get_origin(kind) is tuple:
        first, *rest = get_args(kind)
        if rest == [Ellipsis]:
            return {"type": "array", "items": _schema(first)}
        parts = [_schema(part) for part in (first, *rest)]
        return {"type": "array", "prefixItems": parts, "items": False, "minItems": len(parts)}
    (member,) = _union_members(kind)
    return {"anyOf": [_schema(member), {"type": "null"}]}
