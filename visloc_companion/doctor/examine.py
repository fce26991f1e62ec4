"""The whole examination: facts are collected, judged, and where it is wished the autopilot is set right."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from visloc_companion.adapters.mavlink.signing import SigningSettings, stamp_at_zero
from visloc_companion.adapters.mavlink.signing_key import read_key
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.config import Config
from visloc_companion.doctor.collect.camera import read_camera
from visloc_companion.doctor.collect.conversation import Conversation
from visloc_companion.doctor.collect.maps import read_map
from visloc_companion.doctor.collect.model import read_model
from visloc_companion.doctor.collect.parameters import Parameters
from visloc_companion.doctor.collect.system import read_system
from visloc_companion.doctor.collect.vehicle import Vehicle, read_vehicle
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import Judged, agree, judge
from visloc_companion.doctor.parameter_file import changes
from visloc_companion.doctor.rules.registry import RULES
from visloc_companion.errors import LinkError
from visloc_companion.types import AutopilotKind

_ROUNDS, _AGAIN_S = 3, 20.0


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is asked of an examination. `apply`: set what must change; refused while armed."""

    url: str = ""
    config: Config | None = None
    seconds: float = 5.0
    wait_s: float = 10.0
    apply: bool = False


@dataclass(frozen=True, slots=True)
class Report:
    """What came out. `changes` is what must be set; `applied` what was set and read back.

    `problem`: no autopilot answered (then the rest is judged all the same), or it was not set right.
    """

    facts: Facts
    judged: list[Judged]
    changes: Mapping[str, float]
    types: Mapping[str, int] = field(default_factory=dict)
    applied: Mapping[str, float] = field(default_factory=dict)
    problem: LinkError | None = None


async def examine(wishes: Wishes) -> Report:
    """Examine an installation. Raises ConfigError for a signing key or a URL that is none."""
    config = wishes.config or Config()
    conversation = Conversation(wishes.url, config.link.system_id, _signing(config)) if wishes.url else None
    if conversation is None:
        return await _report(wishes, config, None, None)
    try:
        await conversation.open()
        vehicle = await read_vehicle(conversation, config, wishes.seconds, wishes.wait_s)
        return await _report(wishes, config, vehicle, conversation)
    except LinkError as problem:
        return replace(await _report(wishes, config, None, None), problem=problem)
    finally:
        await conversation.close()


def _signing(config: Config) -> SigningSettings | None:
    """The key of the configuration. Raises ConfigError for a file that is none."""
    if not config.link.signing_key_file:
        return None
    at_zero = stamp_at_zero(time.time_ns(), time.monotonic_ns())
    return SigningSettings(read_key(Path(config.link.signing_key_file)), config.link.signing_link_id, True, at_zero)


async def _report(wishes: Wishes, config: Config, vehicle: Vehicle | None, conversation: Conversation | None) -> Report:
    facts = await _facts(wishes, config, vehicle, conversation)
    judged = judge(RULES, facts)
    if vehicle is None or conversation is None:
        return Report(facts, judged, {})
    new = changes(RULES, facts)
    report = Report(facts, agree(judged, new), new, dict(vehicle.parameters.types))
    done: dict[str, float] = {}
    try:
        if wishes.apply:
            await _apply_all(conversation, vehicle.parameters, facts, done)
    except LinkError as problem:
        return replace(report, applied=done, problem=problem)
    return replace(report, applied=done)


async def _apply_all(conversation: Conversation, parameters: Parameters, facts: Facts, done: dict[str, float]) -> None:
    """Apply what must change, and what must among the parameters that show only then (VISO_TYPE hides the other VISO_*)."""
    for _ in range(_ROUNDS):
        before = len(done)
        await apply(conversation, parameters, changes(RULES, facts), done)
        if len(done) == before:
            return
        await parameters.read_again(_AGAIN_S)
        facts = replace(facts, parameters=dict(parameters.values))


async def apply(conversation: Conversation, parameters: Parameters, new: Mapping[str, float], done: dict[str, float]) -> None:
    """Set parameters and read each back into `done`; what the autopilot does not have is left out.

    Raises LinkError where the vehicle is armed, or does not take a value.
    """
    for name, value in new.items():
        if conversation.armed:
            raise LinkError(
                f"the vehicle is armed: nothing more is set (so far {', '.join(done) or 'nothing'})",
                where=str(conversation.endpoint),
                remedy="disarm, then run it again",
            )
        if name in parameters.types:
            await parameters.set(name, value)
            done[name] = value


async def _facts(wishes: Wishes, config: Config, vehicle: Vehicle | None, conversation: Conversation | None) -> Facts:
    """The autopilot's part is read already; the rest blocks, so it is read in threads."""
    link = None if vehicle is None else vehicle.link
    system = await asyncio.to_thread(read_system, config)
    named = wishes.config
    camera = None if named is None else await read_camera(named, MonotonicClock(), wishes.seconds)
    model, network = (None, None) if named is None else await asyncio.to_thread(read_model, named)
    found_map = None if named is None else await asyncio.to_thread(read_map, named, link, network)
    return Facts(
        autopilot=AutopilotKind.UNKNOWN if conversation is None else conversation.kind,
        version="" if vehicle is None else vehicle.version,
        parameters={} if vehicle is None else dict(vehicle.parameters.values),
        config=named,
        link=link,
        camera=camera,
        map=found_map,
        model=model,
        system=system,
    )
