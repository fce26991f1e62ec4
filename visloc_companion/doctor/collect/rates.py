"""Asks the autopilot for the messages that the daemon would ask for, and counts what comes.

The rates are taken back at the end, so that the link is left as the autopilot's own settings make it.
"""

from __future__ import annotations

import asyncio
import statistics
import time
from dataclasses import dataclass

import numpy as np

from visloc_companion.adapters.mavlink.codec_gimbal import frame_of
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.app.settings import core_settings
from visloc_companion.config import Config
from visloc_companion.core.streams import requests_for
from visloc_companion.doctor.collect.conversation import Conversation
from visloc_companion.doctor.facts import GimbalHeard
from visloc_companion.types import RequestMessage, TimesyncSample

_ANSWER_S, _FIRST_S, _TIMESYNC_S, _STEPS = 1.0, 2.0, 0.1, (1.0, 0.75, 0.5)
_LEAST_SAMPLES, _LEAST_SPAN_S, _MORE_TIMES = 10, 2.0, 2


@dataclass(frozen=True, slots=True)
class Measured:
    """Rates (by message name), round trips, how much faster the autopilot's clock runs than ours (ppm, 1-sigma), and what gimbals
    say."""

    asked_hz: dict[str, float]
    rates_hz: dict[str, float]
    refused: frozenset[str]
    rtt_ms: tuple[float, ...]
    timesync_requests_hz: float
    drift_ppm: float | None
    drift_sigma_ppm: float
    gimbals: tuple[GimbalHeard, ...]


async def measure(conversation: Conversation, config: Config, seconds: float) -> Measured:
    """Ask, count for some seconds, and take the rates back."""
    wanted = {
        request.message_id: request.rate_hz
        for request in requests_for(conversation.kind, core_settings(config))
        if isinstance(request, RequestMessage) and request.rate_hz > 0
    }
    names = {number: str(mav.mavlink_map[number].msgname) for number in wanted}
    refused = [names[number] for number, rate_hz in wanted.items() if not await _ask(conversation, number, rate_hz)]
    await _see_to_it(conversation, wanted, names)
    counts, samples, requests = dict(conversation.counts), len(conversation.samples), conversation.timesync_requests
    pointed, start = len(conversation.pointed), time.monotonic()
    while (elapsed := time.monotonic() - start) < seconds:
        conversation.ask_time()
        await asyncio.sleep(min(_TIMESYNC_S, seconds - elapsed))
    elapsed = time.monotonic() - start
    for number in wanted:
        conversation.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, number, 0.0)
    answered = conversation.samples[samples:]
    drift_ppm, sigma_ppm = drift(answered)
    return Measured(
        asked_hz={names[number]: rate_hz for number, rate_hz in wanted.items()},
        rates_hz={name: (conversation.counts[name] - counts.get(name, 0)) / elapsed for name in names.values()},
        refused=frozenset(refused),
        rtt_ms=tuple((sample.t_rx_ns - sample.t_sent_ns) / 1e6 for sample in answered),
        timesync_requests_hz=(conversation.timesync_requests - requests) / elapsed,
        drift_ppm=drift_ppm,
        drift_sigma_ppm=sigma_ppm,
        gimbals=gimbals_of(conversation.pointed[pointed:], elapsed),
    )


def gimbals_of(messages: list[Message], seconds: float) -> tuple[GimbalHeard, ...]:
    """The gimbals in GIMBAL_DEVICE_ATTITUDE_STATUS messages of so many seconds."""
    frames: dict[int, list[str | None]] = {}
    for message in messages:
        component = message.get_srcComponent()
        number = int(message.gimbal_device_id or 1) if component == AUTOPILOT_COMPONENT else int(component)
        frames.setdefault(number, []).append(frame_of(message.flags))
    return tuple(
        GimbalHeard(number, len(said) / seconds, frozenset(str(frame) for frame in said if frame is not None))
        for number, said in sorted(frames.items())
    )


async def _see_to_it(conversation: Conversation, wanted: dict[int, float], names: dict[int, str]) -> None:
    """Ask again for what does not come: ArduPilot acknowledges rates before it is ready and forgets them; orders go lost."""
    counts = dict(conversation.counts)

    def missing() -> list[int]:
        return [number for number, name in names.items() if conversation.counts[name] == counts.get(name, 0)]

    for _ in range(_MORE_TIMES):
        await conversation.until(lambda: not missing(), _FIRST_S)
        for number in missing():
            await _ask(conversation, number, wanted[number])


def drift(samples: list[TimesyncSample]) -> tuple[float | None, float]:
    """Slope of the autopilot's clock against ours, from exchanges that took no more than the median; and its 1-sigma, ppm.

    None where there are too few, or they span too little.
    """
    if len(samples) < _LEAST_SAMPLES:
        return None, 0.0
    typical = statistics.median(sample.t_rx_ns - sample.t_sent_ns for sample in samples)
    good = [sample for sample in samples if sample.t_rx_ns - sample.t_sent_ns <= typical]
    middle = np.array([(sample.t_rx_ns + sample.t_sent_ns) // 2 - samples[0].t_rx_ns for sample in good], dtype=np.float64) / 1e9
    ahead = np.array([sample.t_remote_ns - samples[0].t_remote_ns for sample in good], dtype=np.float64) / 1e9 - middle
    span = middle - middle.mean()
    if len(good) < _LEAST_SAMPLES // 2 or np.ptp(middle) < _LEAST_SPAN_S:
        return None, 0.0
    slope = float(span @ (ahead - ahead.mean()) / (span @ span))
    left = ahead - ahead.mean() - slope * span
    noise_s = max(float(np.std(left)), typical / 1e9 / 4)
    return 1e6 * slope, 1e6 * noise_s / float(np.sqrt(span @ span))


async def _ask(conversation: Conversation, number: int, rate_hz: float) -> bool:
    """SET_MESSAGE_INTERVAL as the daemon does it, slower where it is denied; whether the wanted rate was granted."""
    for step in _STEPS:
        conversation.last.pop("COMMAND_ACK", None)
        conversation.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, number, round(1e6 / (step * rate_hz)))
        await conversation.until(lambda: _answer(conversation) is not None, _ANSWER_S)
        if _answer(conversation) != mav.MAV_RESULT_DENIED:
            return step == 1.0
    return False


def _answer(conversation: Conversation) -> int | None:
    answer = conversation.last.get("COMMAND_ACK")
    mine = answer is not None and answer.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL
    return int(answer.result) if mine and answer is not None else None
