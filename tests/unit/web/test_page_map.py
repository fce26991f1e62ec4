"""The whole page, in Node where that is installed, over a document of straw: which map's tiles it asks for."""

from __future__ import annotations

from typing import Any

from tests.unit.web.in_node import printed

WORLD = """
const straw = () => new Proxy(function () {}, {
  get: (kept, key) => key === Symbol.toPrimitive ? () => 300 : key === Symbol.iterator ? function* () {} : kept[key] ??= straw(),
  set: (kept, key, value) => { kept[key] = value; return true; },
  apply: () => straw(),
});
const opened = [], asked = [], elements = {}, frames = [];
Object.assign(globalThis, {
  devicePixelRatio: 1,
  document: { getElementById: (id) => elements[id] ??= straw(), documentElement: straw(), body: straw(), createElement: straw },
  matchMedia: straw, addEventListener: () => 0, getComputedStyle: () => straw(), setInterval: () => 0, setTimeout: () => 0,
  ResizeObserver: class { observe() {} }, requestAnimationFrame: (then) => frames.push(then),
  Image: class { set src(path) { asked.push(path); } },
  EventSource: class {
    constructor() { this.takes = {}; opened.push(this); }
    addEventListener(name, take) { this.takes[name] = take; }
    close() {}
  },
  fetch: async () => ({ json: async () => ({ map: told.map, problem: "" }) }),
});
const told = { map: null };
const map = (identity, lat) => ({
  identity, gsd_m: 1, rows: 400, cols: 400, tile_px: 512, levels: 1, lattice: 2,
  places: [[lat, 8], [lat, 8.005], [lat - 0.003, 8], [lat - 0.003, 8.005]],
});
const begin = async () => {
  opened.at(-1).takes.history({ data: JSON.stringify({ samples: [], began: 1 }) });
  await new Promise((done) => setImmediate(done));
  frames.splice(0).map((paint) => paint());
};
for (const id of ["map", "traces"]) Object.assign(document.getElementById(id), { clientWidth: 400, clientHeight: 300 });
await import("%s");
"""


def asked(steps: str) -> Any:
    """The tiles that were asked for, in order, after some steps."""
    return printed(WORLD + steps + "console.log(JSON.stringify(asked));", "main.js")


def test_a_server_that_is_started_anew_over_another_pack_gets_its_tiles_asked_for() -> None:
    """The page asked for the old pack's, which nobody has, until it was loaded anew."""
    steps = "told.map = map('old', 47); await begin(); told.map = map('new', 46); await begin();"
    assert asked(steps) == ["api/map/old/0/0/0.webp", "api/map/new/0/0/0.webp"]


def test_the_same_pack_is_not_fetched_again_and_one_that_is_gone_not_asked_for() -> None:
    assert asked("told.map = map('old', 47); await begin(); await begin();") == ["api/map/old/0/0/0.webp"]
    assert asked("told.map = map('old', 47); await begin(); told.map = null; await begin();") == ["api/map/old/0/0/0.webp"]
