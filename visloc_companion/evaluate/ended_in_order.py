"""Long work that is told to end takes along what it has started."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from typing import Any, TypeVar

Result = TypeVar("Result")


class BrokenOff(KeyboardInterrupt):
    """Work that was told to end, with what was done until then: a document as of all, with `complete` false, and its results."""

    def __init__(self, document: dict[str, Any], results: list[Any], why: BaseException) -> None:
        super().__init__("broken off")
        self.document, self.results, self.why = document, results, why


def done_until_broken_off(results: Iterator[Result], into: list[Result], on_each: Callable[[], None]) -> BaseException | None:
    """Take results one by one; None, or what told the work to end after the first of them. A generator is told so, too, and what
    it has ready is taken."""
    try:
        for result in results:
            into.append(result)
            on_each()
    except (KeyboardInterrupt, SystemExit) as why:
        if isinstance(results, Generator):
            with suppress(StopIteration, type(why)):
                into.append(results.throw(why))
                into.extend(results)
        if not into:
            raise
        return why
    return None


def aside(work: Callable[[], Iterator[Result]], stop: Callable[[], None]) -> Generator[Result, None, None]:
    """What `work` yields, done in a thread of its own, where no signal raises; what it raises is raised here.

    A signal that raises amid the locks of a pool (concurrent.futures) leaves them locked, and the pool waits for them for ever.
    So whoever may hear one only waits. Told to end, or closed: `stop`, after which `work` has to end soon, and is waited for.
    Told to end, what it has yielded by then comes first.
    """
    done, failed = list[Result](), list[BaseException]()
    news, given = SimpleQueue[None](), 0  # whose get() may be broken off, and what it gave then be lost

    def do() -> None:
        try:
            for result in work():
                done.append(result)
                news.put(None)
        except BaseException as why:
            failed.append(why)
        finally:
            news.put(None)

    thread = threading.Thread(target=do, name="aside")
    try:
        thread.start()
        while news.get() is None and given < len(done):
            yield done[(given := given + 1) - 1]  # no call in between: a signal raises before it is counted, or once it is given
    except (KeyboardInterrupt, SystemExit):
        by_then = len(done)
        _end(thread, stop)
        yield from done[given:by_then]
        raise
    finally:
        _end(thread, stop)
    if failed:
        raise failed[0]


def _end(thread: threading.Thread, stop: Callable[[], None]) -> None:
    stop()
    if thread.is_alive():
        thread.join()


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
