"""The places of the mission that the autopilot holds (MISSION_REQUEST_LIST, MISSION_REQUEST_INT)."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, GLOBAL_FRAMES, Message, mav
from visloc_companion.doctor.collect.conversation import Conversation
from visloc_companion.types import GeoPoint

_ANSWER_S, _TRIES = 1.0, 3
_MISSION_FRAMES = (*GLOBAL_FRAMES, mav.MAV_FRAME_GLOBAL_TERRAIN_ALT, mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT)


async def read_mission(conversation: Conversation) -> tuple[GeoPoint, ...] | None:
    """Where the mission goes, in order (heights are not used and are zero); None where the autopilot does not answer."""
    items: dict[int, Message] = {}

    def heard(message: Message) -> None:
        if message.get_type() == "MISSION_ITEM_INT":
            items[int(message.seq)] = message

    conversation.listeners.append(heard)
    try:
        count = await _count(conversation)
        if count is None:
            return None
        for number in range(count):
            if not await _item(conversation, items, number):
                return None
    finally:
        conversation.listeners.remove(heard)
    accepted = mav.MAVLink_mission_ack_message(conversation.system_id, AUTOPILOT_COMPONENT, mav.MAV_MISSION_ACCEPTED)
    conversation.send(accepted)
    return tuple(place for number in sorted(items) if (place := _place(items[number])) is not None)


async def _count(conversation: Conversation) -> int | None:
    for _ in range(_TRIES):
        conversation.last.pop("MISSION_COUNT", None)
        conversation.send(mav.MAVLink_mission_request_list_message(conversation.system_id, AUTOPILOT_COMPONENT))
        if await conversation.until(lambda: "MISSION_COUNT" in conversation.last, _ANSWER_S):
            return int(conversation.last["MISSION_COUNT"].count)
    return None


async def _item(conversation: Conversation, items: dict[int, Message], number: int) -> bool:
    for _ in range(_TRIES):
        conversation.send(mav.MAVLink_mission_request_int_message(conversation.system_id, AUTOPILOT_COMPONENT, number))
        if await conversation.until(lambda: number in items, _ANSWER_S):
            return True
    return False


def _place(item: Message) -> GeoPoint | None:
    goes = item.command <= mav.MAV_CMD_NAV_LAST and item.command != mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
    if not goes or item.frame not in _MISSION_FRAMES or (item.x == 0 and item.y == 0):
        return None
    return GeoPoint(item.x * 1e-7, item.y * 1e-7, 0.0)
