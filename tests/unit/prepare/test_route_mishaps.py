"""Routes that are none: what is wrong is said in the words of the file, not in those of the program alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from visloc_companion.errors import MapError
from visloc_companion.prepare.route import read_route


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.plan", '{"mission": 3}', "it is not laid out as QGroundControl does it"),
        ("a.plan", '{"mission": {}}', "'items' is missing"),
        ("a.plan", json.dumps({"mission": {"items": [{"params": []}]}}), "item 1: 'type' is missing"),
        ("a.plan", json.dumps({"mission": {"items": [3]}}), "item 1: it is not laid out as QGroundControl does it"),
        (
            "a.plan",
            json.dumps({"mission": {"items": [{"type": "SimpleItem", "command": 16, "params": [0, 0, 0, 0, "x", 9, 1]}]}}),
            "item 1: could not convert string to float: 'x'",
        ),
        (
            "a.plan",
            json.dumps({"mission": {"items": [{"type": "ComplexItem", "complexItemType": "odd"}]}}),
            r"item 1 \(odd\) does not say where it flies",
        ),
        (
            "a.csv",
            "lat_deg;lon_deg\n46,99;9,00\n",
            r"names no column lat_deg and lon_deg \(lat_deg;lon_deg\); separate columns by commas, and write decimals with a",
        ),
        ("a.csv", "Lat_Deg,lon_deg\n46.9,9.0\n", r"names no column lat_deg \(Lat_Deg, lon_deg\); remedy"),
        ("a.csv", "", r"names no column lat_deg and lon_deg \(nothing\)"),
    ],
)
def test_what_is_no_route_is_told_in_the_words_of_its_file(tmp_path: Path, name: str, text: str, told: str) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MapError, match=rf"a\.\w+: is no route: .*{told}"):
        read_route(path)
