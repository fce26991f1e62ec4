"""Long work that is told to end takes along what it has started."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

Result = TypeVar("Result")


class BrokenOff(KeyboardInterrupt):
    """Work that was told to end, with what was done until then: a document as of all, with `complete` false, and its results."""

    def __init__(self, document: dict[str, Any], results: list[Any], why: BaseException) -> None:
        super().__init__("broken off")
        self.document, self.results, self.why = document, results, why


def done_until_broken_off(results: Iterator[Result], into: list[Result], on_each: Callable[[], None]) -> BaseException | None:
    """Take results one by one; None, or what told the work to end after the first of them. A generator is closed then."""
    try:
        for result in results:
            into.append(result)
            on_each()
    except (KeyboardInterrupt, SystemExit) as why:
        if isinstance(results, Generator):
            results.close()
        if not into:
            raise
        return why
    return None


@contextmanager
def ended_in_order() -> Iterator[None]:
    """SIGTERM and SIGHUP unwind, as Ctrl-C does: else the processes that were started would fly on with nobody to end them.

    Raises SystemExit (128 + the signal's number) where one of them comes. Outside the main thread, which alone may hear signals,
    nothing is changed.
    """

    def end(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) is not signal.SIG_IGN]  # nohup
    before = {number: signal.signal(number, end) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
