"""Topics of a journal, what is written of each kind of record, and what it says when it is read."""

from __future__ import annotations

import json
import struct
from dataclasses import asdict
from pathlib import Path
from typing import Any

from visloc_companion.app.journal_header import OTHER_VERSION
from visloc_companion.app.salvage import Record
from visloc_companion.app.serialise import from_dict, to_json
from visloc_companion.errors import JournalError

HEADER, MAVLINK_IN, MAVLINK_OUT, NOTICE, FRAME = "/header", "/mavlink/in", "/mavlink/out", "/shell/Notice", "/camera/png"
BINARY = (MAVLINK_IN, MAVLINK_OUT, FRAME)
_parse = json.JSONDecoder().raw_decode


def payload(topic: str, thing: Any) -> bytes:
    """A header, bytes of the link, a frame (number, pixels), an event, a command or a notice as the journal has it."""
    if topic == HEADER:
        return json.dumps(asdict(thing), allow_nan=False).encode()
    if topic == FRAME:
        import cv2

        frame_id, pixels = thing
        bgr = pixels if pixels.ndim == 2 else pixels[:, :, ::-1]
        return struct.pack("<Q", frame_id) + cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
    return thing if isinstance(thing, bytes) else to_json(thing).encode()


def parsed(record: Record, path: Path) -> Any:
    """The JSON of a record; None where its topic is not known and it is none. Raises JournalError."""
    try:
        if not record.data.startswith(b'{"'):
            return json.loads(record.data)  # it looks for the encoding first
        text = record.data.decode()
        parsed, end = _parse(text)
        return parsed if end == len(text) else json.loads(text)
    except (ValueError, RecursionError) as why:
        if record.topic is None:
            return None
        raise JournalError(f"record {record.sequence} is not JSON: {why}", where=str(path)) from why


def thing_of(data: Any, record: Record, path: Path) -> Any:
    """The event or command that it states. Raises JournalError."""
    try:
        return from_dict(data)
    except JournalError as why:
        raise JournalError(f"record {record.sequence}: {why.what}", where=str(path), remedy=OTHER_VERSION) from why
