"""What a simulated flight came to, as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from visloc_companion.evaluate.record import FlightRecord


def write_result(record: FlightRecord, result: dict[str, Any], json_file: Path) -> None:
    """The JSON of a flight, and beside it its epochs as CSV, unless it goes into a pipe. Raises ConfigError where they cannot be
    written."""
    from visloc_companion.cli.progress import result_to, write_json
    from visloc_companion.evaluate.metrics import write_epochs
    from visloc_companion.whole_file import is_stream

    if is_stream(json_file):  # nothing lies beside /dev/stdout
        write_json(json_file, {**result, "epochs": None})
        return
    epochs = json_file.with_name(f"{json_file.stem}-epochs.csv")
    write_json(json_file, {**result, "epochs": str(epochs)})
    with result_to(epochs, "--json"):
        write_epochs(record, epochs)
