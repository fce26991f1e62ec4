"""The whole examination over a socket: the built-in autopilot as recommended is green; what is wrong is named, and set right."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.unit.doctor.conftest import HOME, recommended
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.config import CameraConfig, parse_config
from visloc_companion.doctor.collect.rates import gimbals_of
from visloc_companion.doctor.examine import Report, Wishes, examine
from visloc_companion.doctor.facts import GimbalHeard
from visloc_companion.doctor.finding import Level
from visloc_companion.doctor.report import as_json, summary
from visloc_companion.errors import ConfigError
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.faults import no_gnss
from visloc_companion.sim.vehicles.gimbal import GimbalPlan
from visloc_companion.testing.loopback import free_port
from visloc_companion.testing.signing_peer import PymavlinkSigning
from visloc_companion.types import AutopilotKind

KINDS = [AutopilotKind.ARDUPILOT, AutopilotKind.PX4]
BY_MACHINE = ("system-", "link-round-trip", "link-jitter", "link-clock-drift")
"""How busy this machine is."""
CONFIG = parse_config({"injection": {"switch_source": True}, "localiser": {"terrain": True}, "journal": {"folder": "journals"}})


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over loopback what does not come soon never comes."""
    for name in ("vehicle._ANSWER_S", "mission._ANSWER_S", "rates._ANSWER_S", "parameters._QUIET_S"):
        monkeypatch.setattr(f"visloc_companion.doctor.collect.{name}", 0.4)


def pilot_of(kind: AutopilotKind, grounded: bool = False, **parameters: float) -> BuiltInAutopilot:
    """Flying its mission, or on the ground without GNSS and so disarmed."""
    on_ground: dict[str, Any] = {"start_airborne": False, "faults": no_gnss()} if grounded else {}
    told = recommended(kind) | parameters
    return BuiltInAutopilot(kind, "copter", HOME, [(0.0, 0.0, -100.0)], 10.0, 1, parameters=told, **on_ground)


async def examined(served: Callable[..., Any], pilot: BuiltInAutopilot, apply: bool = False) -> Report:
    port = free_port(socket.SOCK_DGRAM)
    async with served(pilot, port):
        return await examine(Wishes(f"udpin:127.0.0.1:{port}", CONFIG, seconds=1.2, wait_s=30.0, apply=apply))


@asynccontextmanager
async def beating(heartbeat: Any, sender: tuple[int, int], port: int) -> AsyncIterator[None]:
    """Somebody's HEARTBEAT, by system and component, five times a second on a port of this computer."""
    packer = mav.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])

    async def beat() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            while True:
                line.sendto(heartbeat.pack(packer), ("127.0.0.1", port))
                await asyncio.sleep(0.2)

    task = asyncio.create_task(beat())
    try:
        yield
    finally:
        task.cancel()


def bad(report: Report) -> dict[str, str]:
    levels = {answer.rule.id: str(answer.level) for answer in report.judged if answer.level in (Level.RED, Level.AMBER)}
    return {rule: level for rule, level in levels.items() if not rule.startswith(BY_MACHINE)}


@pytest.mark.parametrize("kind", KINDS)
async def test_recommended_parameters_are_green(served: Callable[..., Any], kind: AutopilotKind, tmp_path: Any) -> None:
    report = await examined(served, pilot_of(kind))
    rates = {"link-attitude-rate", "link-imu-rate", "link-global-rate", "link-local-rate", "link-gnss-rate", "link-status-rate"}
    assert {rule for rule in bad(report) if rule not in rates} == set()
    assert report.changes == {}
    assert report.facts.link is not None
    assert report.facts.link.mission is not None
    assert len(report.facts.link.mission) == 1
    assert report.facts.link.home == report.facts.link.origin == pytest.approx(HOME)
    assert report.facts.link.rates_hz["ATTITUDE"] > 0
    data = json.loads(json.dumps(as_json(report), allow_nan=False))
    assert set(data) == {"schema", "autopilot", "version", "rules"}
    assert (data["schema"], data["autopilot"]) == (1, str(kind))
    assert len(data["rules"]) >= 45
    assert all(set(rule) == {"id", "level", "read", "why", "remedy"} for rule in data["rules"])
    assert summary(report).startswith(f"{kind} {data['version']}: ")


@pytest.mark.parametrize(
    ("kind", "wrong", "rule"),
    [
        (AutopilotKind.ARDUPILOT, {"VISO_QUAL_MIN": 50.0, "EK3_SRC2_POSXY": 3.0}, "ap-vision-set-position"),
        (AutopilotKind.PX4, {"EKF2_EV_CTRL": 14.0, "COM_POS_FS_EPH": 1.0}, "px4-ev-control"),
    ],
)
async def test_what_is_wrong_is_set_right_on_the_ground(
    served: Callable[..., Any], kind: AutopilotKind, wrong: dict[str, float], rule: str
) -> None:
    pilot = pilot_of(kind, grounded=True, **wrong)
    report = await examined(served, pilot, apply=True)
    assert bad(report)[rule] == "red"
    assert set(report.changes) == set(report.applied) == set(wrong)
    for name in wrong:
        assert pilot.parameters[name] == pytest.approx(report.changes[name])
    assert pilot.parameters.get("EKF2_EV_CTRL", 1.0) == 1.0


class Lossy(BuiltInAutopilot):
    """Loses every third PARAM_VALUE on its way."""

    lost = 0

    def outgoing(self) -> bytes:
        """See BuiltInAutopilot."""
        kept, parser = b"", mav.MAVLink(None)
        parser.robust_parsing = True
        for message in parser.parse_buffer(super().outgoing()) or []:
            values = message.get_type() == "PARAM_VALUE"
            self.lost += values
            kept += b"" if values and self.lost % 3 == 0 else message.get_msgbuf()
        return kept


async def test_parameters_that_were_lost_are_asked_for_again(served: Callable[..., Any]) -> None:
    kind = AutopilotKind.PX4
    report = await examined(served, Lossy(kind, "copter", HOME, [(0.0, 0.0, -100.0)], 10.0, 1, parameters=recommended(kind)))
    assert report.facts.link is not None
    assert len(report.facts.parameters) == report.facts.link.parameters_expected > 20
    assert report.facts.parameters["EKF2_NOAID_TOUT"] == 5e6


class Hiding(BuiltInAutopilot):
    """Shows the other VISO_* once VISO_TYPE is not 0, as ArduPilot does, and loses every tenth message on the way."""

    sent = 0

    def outgoing(self) -> bytes:
        """See BuiltInAutopilot."""
        if self.parameters["VISO_TYPE"] != 0:
            self.parameters.setdefault("VISO_POS_M_NSE", 0.2)
        kept, parser = b"", mav.MAVLink(None)
        parser.robust_parsing = True
        for message in parser.parse_buffer(super().outgoing()) or []:
            self.sent += 1
            kept += b"" if self.sent % 10 == 0 else message.get_msgbuf()
        return kept


async def test_parameters_that_show_only_then_are_set_too_and_losses_are_seen(served: Callable[..., Any]) -> None:
    kind = AutopilotKind.ARDUPILOT
    pilot = Hiding(kind, "copter", HOME, [(0.0, 0.0, -100.0)], 10.0, 1, start_airborne=False, faults=no_gnss())
    pilot.parameters.update(recommended(kind) | {"VISO_TYPE": 0.0})
    del pilot.parameters["VISO_POS_M_NSE"]
    report = await examined(served, pilot, apply=True)
    assert report.problem is None
    assert (report.changes, report.applied) == ({"VISO_TYPE": 1.0}, {"VISO_TYPE": 1.0, "VISO_POS_M_NSE": 0.5})
    assert pilot.parameters["VISO_POS_M_NSE"] == 0.5
    assert report.facts.link is not None
    assert report.facts.link.lost_share == pytest.approx(0.1, abs=0.03)
    assert bad(report)["link-loss"] == "amber"


async def test_rates_that_were_forgotten_are_asked_for_again(served: Callable[..., Any]) -> None:
    """ArduPilot accepts them before it is ready."""
    pilot = BuiltInAutopilot(
        AutopilotKind.ARDUPILOT,
        "copter",
        HOME,
        [(0.0, 0.0, -100.0)],
        10.0,
        1,
        parameters=recommended(AutopilotKind.ARDUPILOT),
        ready_s=1.2,
    )
    report = await examined(served, pilot)
    assert report.facts.link is not None
    assert report.facts.link.rates_hz["ATTITUDE"] > 0


class Mute(BuiltInAutopilot):
    """Says HEARTBEAT and nothing else."""

    def receive(self, data: bytes) -> None:
        """See BuiltInAutopilot."""


async def test_an_autopilot_that_only_beats_is_red_where_it_matters_and_skipped_elsewhere(served: Callable[..., Any]) -> None:
    report = await examined(served, Mute(AutopilotKind.ARDUPILOT, "copter", HOME, [(0.0, 0.0, -100.0)], 10.0, 1))
    levels = {answer.rule.id: str(answer.level) for answer in report.judged}
    assert report.problem is None
    assert (levels["ap-viso-type"], levels["firmware-measured"], levels["link-clock-drift"]) == ("skipped",) * 3
    assert (levels["link-parameters"], levels["link-round-trip"], levels["link-attitude-rate"]) == ("red", "red", "red")


class Signing(BuiltInAutopilot):
    """Signs all that it says with a key."""

    def __init__(self, key: bytes) -> None:
        kind = AutopilotKind.ARDUPILOT
        super().__init__(kind, "copter", HOME, [(0.0, 0.0, -100.0)], 10.0, 1, parameters=recommended(kind))
        self._peer, self._packer = PymavlinkSigning(key, stamp=10**9), mav.MAVLink(None, srcSystem=1, srcComponent=1)

    def outgoing(self) -> bytes:
        """See BuiltInAutopilot."""
        parser = mav.MAVLink(None)
        parser.robust_parsing = True
        return b"".join(self._peer.pack(message, self._packer) for message in parser.parse_buffer(super().outgoing()) or [])


@pytest.mark.parametrize(("passphrase", "level"), [("the one", "green"), ("another", "red")])
async def test_a_key_that_is_not_the_autopilots_is_red(
    served: Callable[..., Any], tmp_path: Path, passphrase: str, level: str
) -> None:
    """Both sign: with the wrong key the autopilot refuses all that the daemon says, and the daemon all that it says."""
    file = tmp_path / "signing.key"
    file.write_text(passphrase)
    file.chmod(0o600)
    config = parse_config({"link": {"signing_key_file": str(file)}})
    port = free_port(socket.SOCK_DGRAM)
    async with served(Signing(hashlib.sha256(b"the one").digest()), port):
        report = await examine(Wishes(f"udpin:127.0.0.1:{port}", config, seconds=1.2, wait_s=30.0))
    (signing,) = [answer for answer in report.judged if answer.rule.id == "config-signing"]
    assert str(signing.level) == level
    assert ("another key" in signing.read) == (level == "red")


async def test_a_second_vehicle_on_the_same_port_is_told(served: Callable[..., Any]) -> None:
    """The daemon would keep to the one that it hears first, and so does the doctor."""
    port = free_port(socket.SOCK_DGRAM)
    other = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, mav.MAV_STATE_STANDBY, 3)
    async with beating(other, (2, 1), port), served(pilot_of(AutopilotKind.ARDUPILOT), port):
        report = await examine(Wishes(f"udpin:127.0.0.1:{port}", CONFIG, seconds=1.2, wait_s=30.0))
    (second,) = [answer for answer in report.judged if answer.rule.id == "link-second-autopilot"]
    assert second.level is Level.AMBER
    assert "127.0.0.1:" in second.read
    assert "link.system_id" in second.remedy


@pytest.mark.parametrize(
    ("sender", "autopilot", "kind", "told", "counted"),
    [
        ((255, 190), mav.MAV_AUTOPILOT_INVALID, mav.MAV_TYPE_GCS, r"no autopilot.*255/190.*remedy: connect the", "no autopilot"),
        ((1, 1), mav.MAV_AUTOPILOT_GENERIC, mav.MAV_TYPE_QUADROTOR, None, "neither ArduPilot nor PX4"),
    ],
)
async def test_what_is_no_autopilot_that_is_known_is_told(
    sender: tuple[int, int], autopilot: int, kind: int, told: str | None, counted: str
) -> None:
    """A ground station alone; and firmware of another kind, of which no rule of either autopilot is judged."""
    port = free_port(socket.SOCK_DGRAM)
    other = mav.MAVLink_heartbeat_message(kind, autopilot, 0, 0, mav.MAV_STATE_ACTIVE, 3)
    async with beating(other, sender, port):
        report = await examine(Wishes(f"udpin:127.0.0.1:{port}", CONFIG, seconds=1.2, wait_s=3.0))
    assert report.problem is None if told is None else re.search(told, str(report.problem))
    assert summary(report).startswith(f"{counted}: ")
    (answer,) = [answer for answer in report.judged if answer.rule.id == "link-autopilot"]
    assert answer.level is (Level.RED if told is None else Level.SKIPPED)


async def test_nothing_is_set_while_armed_nor_unasked(served: Callable[..., Any]) -> None:
    pilot = pilot_of(AutopilotKind.ARDUPILOT, VISO_QUAL_MIN=50.0)
    report = await examined(served, pilot)
    assert (report.changes, report.applied) == ({"VISO_QUAL_MIN": 0.0}, {})
    refused = await examined(served, pilot, apply=True)
    assert "armed: nothing more is set" in str(refused.problem)
    assert (refused.changes, refused.applied) == (report.changes, {})
    assert pilot.parameters["VISO_QUAL_MIN"] == 50.0


async def test_without_a_link_the_rest_is_judged_all_the_same() -> None:
    report = await examine(Wishes(config=CONFIG))
    levels = {answer.rule.id: answer.level for answer in report.judged}
    assert levels["link-origin"] is levels["ap-viso-type"] is Level.SKIPPED
    assert levels["config-clock"] is levels["system-bits"] is Level.GREEN
    assert summary(report).startswith("no autopilot: ")


async def test_a_silent_link_says_what_to_look_at() -> None:
    report = await examine(Wishes(f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}", CONFIG, wait_s=1.0))
    assert re.search(r"nothing is heard for 1 s.*remedy: power and wires", str(report.problem))
    levels = {answer.rule.id: answer.level for answer in report.judged}
    assert (levels["link-origin"], levels["config-clock"]) == (Level.SKIPPED, Level.GREEN)


async def test_another_system_than_the_configured_one_is_named(served: Callable[..., Any]) -> None:
    port = free_port(socket.SOCK_DGRAM)
    config = parse_config({"link": {"system_id": 9}})
    async with served(pilot_of(AutopilotKind.PX4), port):
        report = await examine(Wishes(f"udpin:127.0.0.1:{port}", config, wait_s=3.0))
    assert "no autopilot of system 9 (autopilots: 1" in str(report.problem)


async def test_a_line_that_cannot_be_opened_names_the_remedy() -> None:
    report = await examine(Wishes("serial:/dev/no-such-port:921600"))
    assert re.search(r"cannot be opened.*dialout", str(report.problem))


async def test_an_address_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="pigeon"):
        await examine(Wishes("pigeon:home:1"))


async def test_a_gimbal_on_the_link_is_heard(served: Callable[..., Any]) -> None:
    """Its rate is asked for as the daemon would."""
    pilot = BuiltInAutopilot(KINDS[0], "copter", HOME, [(0.0, 0.0, -100.0)], 10.0, 1, gimbal=GimbalPlan())
    config = CONFIG.model_copy(update={"camera": CameraConfig(mount="gimbal")})
    port = free_port(socket.SOCK_DGRAM)
    async with served(pilot, port):
        report = await examine(Wishes(f"udpin:127.0.0.1:{port}", config, seconds=1.5, wait_s=30.0))
    assert report.facts.link is not None
    (heard,) = report.facts.link.gimbals
    assert (heard.gimbal_id, heard.frames) == (1, frozenset({"heading"}))
    assert heard.rate_hz > 5.0
    assert not report.facts.link.old_gimbal


def test_gimbals_are_told_apart_by_number_and_component() -> None:
    def said(component: int, number: int, flags: int) -> Any:
        message = mav.MAVLink_gimbal_device_attitude_status_message(0, 0, 1, flags, (1, 0, 0, 0), 0, 0, 0, 0, 0, 0, number)
        packed = message.pack(mav.MAVLink(None, srcSystem=1, srcComponent=component))
        return mav.MAVLink(None).parse_buffer(packed)[0]

    messages = [said(1, 1, 44), said(1, 1, 44), said(1, 2, 64), said(154, 0, 96), said(1, 1, 60)]
    assert gimbals_of(messages, 2.0) == (
        GimbalHeard(1, 1.5, frozenset({"heading"})),
        GimbalHeard(2, 0.5, frozenset({"north"})),
        GimbalHeard(154, 0.5, frozenset()),
    )
