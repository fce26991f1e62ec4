"""COMMAND_LONG with its COMMAND_ACK, one at a time.

An ACK names the command and not its parameters, so two requests of message rates in flight could not be told apart.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.encode import command_long

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Question:
    """A command to be asked; `key` names the asker, and a new question with the same key replaces the waiting one."""

    key: str
    command: int
    params: tuple[float, ...]
    tries: int = 1
    urgent: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back: `result` is MAV_RESULT, None where no ACK came for all the tries."""

    question: Question
    result: int | None


class CommandQueue:
    """Sans-IO: `ask`, then `poll` for what is to be sent, `acknowledged` for what came."""

    def __init__(self, ack_timeout_s: float, component_id: int) -> None:
        self._timeout_ns = round(ack_timeout_s * _NS_PER_S)
        self._component_id = component_id
        self._waiting: deque[Question] = deque()
        self._asked: Question | None = None
        self._tries = 0
        self._deadline_ns = 0

    def ask(self, question: Question) -> None:
        """Queue a question; an urgent one goes first."""
        self.withdraw(question.key)
        if question.urgent:
            self._waiting.appendleft(question)
        else:
            self._waiting.append(question)

    def withdraw(self, key: str) -> None:
        """Forget a question, waiting or asked."""
        self._waiting = deque(q for q in self._waiting if q.key != key)
        if self._asked is not None and self._asked.key == key:
            self._asked = None

    def busy_with(self, key: str) -> bool:
        """Whether a question waits or is asked."""
        return any(q.key == key for q in self._waiting) or (self._asked is not None and self._asked.key == key)

    def clear(self) -> None:
        """Forget everything (the link went down)."""
        self._waiting.clear()
        self._asked = None

    def acknowledged(self, ack: Message, system_id: int, now_ns: int) -> Answer | None:
        """Take a COMMAND_ACK. None where it is for somebody else, for nothing we asked, or says that work goes on."""
        asked = self._asked
        addressee = (getattr(ack, "target_system", 0), getattr(ack, "target_component", 0))
        if asked is None or ack.command != asked.command:
            return None
        if addressee[0] not in (0, system_id) or addressee[1] not in (0, self._component_id):
            return None
        if ack.result == mav.MAV_RESULT_IN_PROGRESS:
            self._deadline_ns = now_ns + self._timeout_ns
            return None
        if ack.result == mav.MAV_RESULT_TEMPORARILY_REJECTED and self._tries < asked.tries:
            return None
        self._asked = None
        return Answer(asked, ack.result)

    def poll(self, system_id: int, now_ns: int) -> tuple[Message | None, Answer | None]:
        """The message to send now, if any, and the question that is given up, if any."""
        given_up = None
        if self._asked is not None:
            if now_ns < self._deadline_ns:
                return None, None
            if self._tries >= self._asked.tries:
                given_up, self._asked = Answer(self._asked, None), None
        if self._asked is None:
            if not self._waiting:
                return None, given_up
            self._asked, self._tries = self._waiting.popleft(), 0
        question = self._asked
        message = command_long(system_id, question.command, *question.params, confirmation=self._tries)
        self._tries += 1
        self._deadline_ns = now_ns + self._timeout_ns
        return message, given_up
