"""Labels on the page's map, in Node where that is installed, on a canvas of straw."""

from __future__ import annotations

from tests.unit.web.in_node import printed

LABELLED = """
globalThis.getComputedStyle = () => ({ getPropertyValue: () => "black" });
globalThis.document = { documentElement: {} };
const boxes = [], nothing = () => 0;
const canvas = { clientWidth: 300 }, measureText = (words) => ({ width: 7 * words.length });
const own = { canvas, measureText, fillRect: (x, y, w) => boxes.push([x, x + w]) };
const context = new Proxy(own, { get: (own, key) => own[key] ?? nothing, set: () => true });
const { gnss } = await import("%s");
for (const x of [100, 290]) gnss(context, { width: 300, pixel: () => [x, 50] }, [0, 0], null, "not_trusted");
console.log(JSON.stringify(boxes));
"""


def test_the_label_of_gnss_stays_on_the_map() -> None:
    """It is right of the diamond, and left of it near the right edge."""
    (left, _), (start, end) = printed(LABELLED, "overlay.js")
    assert left == 116
    assert (start >= 0, end) == (True, 274)
