"""The page's own stream, in Node where that is installed: what browsers do when connections end and when they break silently."""

from __future__ import annotations

from typing import Any

from tests.unit.web.in_node import printed

WORLD = """
const opened = [], waiting = [];
let now = 0;
globalThis.EventSource = class {
  static CLOSED = 2;
  constructor(path) { this.path = path; this.takes = {}; this.readyState = 1; this.closed = false; opened.push(this); }
  addEventListener(name, take) { this.takes[name] = take; }
  close() { this.closed = true; }
  say(name, data) { this.takes[name]({ data: JSON.stringify(data) }); }
  fail() { this.readyState = 2; this.onerror(); }
};
Object.defineProperty(globalThis, "performance", { value: { now: () => now } });
globalThis.setTimeout = (then) => waiting.push(then);
const views = [];
const { Stream } = await import("%s");
const lates = [];
const stream = new Stream(() => 0, (said, late) => { views.push(said); lates.push(late); });
const pass = (ms) => { for (const end = now + ms; now < end;) { now += 500; stream.look(); } };
const told = () => console.log(JSON.stringify([opened.map((o) => o.closed), views]));
"""


def page(steps: str) -> Any:
    """[closed or not of every stream that was opened, the views that were taken] after some steps."""
    return printed(WORLD + steps + "told();", "stream.js")


def test_a_connection_that_broke_without_a_word_is_opened_anew() -> None:
    """A phone that was out of reach for a minute showed "the server is gone" until it was loaded anew."""
    assert page("opened[0].say('view', 1); pass(9000);") == [[False], [1]]
    assert page("opened[0].say('view', 1); pass(12000); opened[1].say('view', 2); pass(9000);") == [[True, False], [1, 2]]
    assert page("pass(32000);") == [[True, True, True, False], []]


def test_a_stream_that_ended_is_opened_once_more() -> None:
    """Refused (too many browsers look): browsers do not try again by themselves."""
    assert page("opened[0].fail(); waiting.splice(0).map((then) => then());") == [[True, False], []]
    late = "opened[0].fail(); pass(11000); waiting.splice(0).map((then) => then()); opened[1].say('view', 3);"
    assert page(late) == [[True, False], [3]]


def test_a_slow_line_may_take_long_for_the_history() -> None:
    """100 kB at 50 kbit/s take 16 s; the page asked for it anew every ten, for ever."""
    slow = "opened[0].onopen(); pass(40000); opened[0].say('history', 1); pass(9000); opened[0].say('view', 2);"
    assert page(slow) == [[False], [2]]
    assert page("opened[0].onopen(); pass(61000);") == [[True, False], []]
    assert page("opened[0].onopen(); opened[0].say('history', 1); pass(11000);") == [[True, False], []]


def test_what_a_line_brings_late_counts_as_old() -> None:
    """Views that waited in the buffers of a slow line were shown as those of now."""
    steps = """
    now = 5000; opened[0].onopen();
    now = 8000; opened[0].say('history', { at_s: 700 });
    now = 8100; opened[0].say('view', { at_s: 703 });
    now = 30000; opened[0].say('view', { at_s: 705 });
    now = 30100; opened[0].say('view', { at_s: 725.2 });
    now = 60000; opened[0].say('view', { at_s: 756 });
    now = 61000; opened[0].say('view', { at_s: 756.5 });
    console.log(JSON.stringify(lates.map((late) => Math.round(late * 10) / 10)));
    """
    assert printed(WORLD + steps, "stream.js") == [0.1, 20.0, 0.0, 0.0, 0.5]
