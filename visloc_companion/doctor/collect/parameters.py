"""All parameters of an autopilot (PARAM_REQUEST_LIST, what is missing by PARAM_REQUEST_READ), and setting some of them.

ArduPilot sends integers as floats, PX4 their bytes in the float field (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE).
"""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.encode import float_of_int32, parameter_value
from visloc_companion.doctor.collect.conversation import Conversation
from visloc_companion.errors import LinkError
from visloc_companion.types import AutopilotKind

REAL_TYPES = (mav.MAV_PARAM_TYPE_REAL32, mav.MAV_PARAM_TYPE_REAL64)
_QUIET_S, _ROUNDS, _SILENT_ROUNDS, _AT_ONCE, _ANSWER_S, _TRIES = 1.5, 120, 3, 30, 1.0, 4
NO_INDEX = 65535
_CHECKSUM = "_HASH_CHECK"
"""PX4 sends it among the parameters, and does not count it as one."""


class Parameters:
    """What the autopilot sent: `values` by name, `types` (MAV_PARAM_TYPE) by name, `expected` how many there should be."""

    def __init__(self, conversation: Conversation) -> None:
        self.values: dict[str, float] = {}
        self.types: dict[str, int] = {}
        self.expected = 0
        self._conversation = conversation
        self._indices: set[int] = set()
        conversation.listeners.append(self._heard)

    async def read_all(self, timeout_s: float) -> None:
        """Ask for the list, which may take so long, then for what did not come until nothing is missing or nothing more comes."""
        self._ask_for_list()
        await self._flow(timeout_s)
        silent = 0
        for _ in range(_ROUNDS):
            if self._complete or silent >= _SILENT_ROUNDS:
                return
            known = len(self._indices)
            await self._ask_for_missing()
            silent = silent + 1 if len(self._indices) == known else 0

    async def read_again(self, timeout_s: float) -> None:
        """Forget what was read, and read all: a parameter that was set may show others (ArduPilot's VISO_TYPE)."""
        self.values.clear()
        self._indices.clear()
        self.expected = 0
        await self.read_all(timeout_s)

    async def set(self, name: str, value: float) -> None:
        """PARAM_SET until PARAM_VALUE says the same. Raises LinkError where the autopilot does not take it."""
        kind = self.types[name]
        field = float_of_int32(round(value)) if self._bytewise(kind) else value
        for _ in range(_TRIES):
            self.values.pop(name, None)
            message = mav.MAVLink_param_set_message(self._conversation.system_id, AUTOPILOT_COMPONENT, name.encode(), field, kind)
            self._conversation.send(message)
            if await self._conversation.until(lambda: self._is(name, value), _ANSWER_S):
                return
        took = self.values.get(name)
        raise LinkError(
            f"{name} did not become {value:g}" + ("" if took is None else f", it is {took:g}"),
            where=str(self._conversation.endpoint),
            remedy="set it in the ground station; some are refused while armed, or have limits",
        )

    @property
    def _complete(self) -> bool:
        return 0 < self.expected <= len(self._indices)

    def _ask_for_list(self) -> None:
        self._conversation.send(mav.MAVLink_param_request_list_message(self._conversation.system_id, AUTOPILOT_COMPONENT))

    async def _ask_for_missing(self) -> None:
        missing = [index for index in range(self.expected) if index not in self._indices][:_AT_ONCE]
        if not missing:
            self._ask_for_list()
        for index in missing:
            message = mav.MAVLink_param_request_read_message(self._conversation.system_id, AUTOPILOT_COMPONENT, b"", index)
            self._conversation.send(message)
        await self._conversation.until(lambda: bool(missing) and self._indices.issuperset(missing), _QUIET_S)

    async def _flow(self, timeout_s: float) -> None:
        """Wait while parameters go on coming, at most `timeout_s`."""
        for _ in range(max(1, math.ceil(timeout_s / _QUIET_S))):
            before = len(self._indices)
            if await self._conversation.until(lambda: self._complete, _QUIET_S) or len(self._indices) == before:
                return

    def _is(self, name: str, value: float) -> bool:
        return math.isclose(self.values.get(name, math.nan), value, rel_tol=1e-5, abs_tol=1e-9)

    def _bytewise(self, kind: int) -> bool:
        return self._conversation.kind is AutopilotKind.PX4 and kind not in REAL_TYPES

    def _heard(self, message: Message) -> None:
        if message.get_type() != "PARAM_VALUE":
            return
        name, value = message.param_id.rstrip("\x00"), parameter_value(message, self._conversation.kind)
        if not math.isfinite(value) or name == _CHECKSUM:
            return
        self.values[name] = value
        self.types[name] = int(message.param_type)
        if message.param_index != NO_INDEX:
            self._indices.add(int(message.param_index))
            self.expected = int(message.param_count)
