"""The built-in autopilot and its camera as a process of their own: MAVLink over UDP, frames over TCP, at a chosen speed.

`python -m visloc_companion.sim.server PLAN.json` flies one scenario and writes what truly happened to the plan's `result`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from visloc_companion.adapters.camera.tcp import StreamedFrame, encode_frame
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.errors import ConfigError, VislocError
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.autopilots.autopilot_flight import PHYSICS_DT_S
from visloc_companion.sim.faults import CompanionClockStep, FaultSchedule, WorkerCrash
from visloc_companion.sim.rendering.render_motion import Shot
from visloc_companion.sim.scenarios import FLIGHTS
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.seen import simulated_camera
from visloc_companion.sim.setup import FlightArea, FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind, GeoPoint, Image, Quat
from visloc_companion.whole_file import write_result

WAKE_S = 0.005
TRUTH_NS = 100_000_000


@dataclass(frozen=True, slots=True)
class ServerPlan:
    """What the process is told; `result` is the file that it writes."""

    scenario: str
    kind: AutopilotKind
    vehicle: VehicleKind
    seed: int
    speed: float
    mavlink_port: int
    camera_port: int
    frame_rate_hz: float
    ortho: str
    dsm: str | None
    home: GeoPoint
    reach_m: float
    gsd_m: float
    turn_rad: float
    result: str

    @classmethod
    def load(cls, path: Path) -> ServerPlan:
        """Read a plan that `save` wrote. Raises ConfigError naming the file and what is wrong with it."""
        try:
            data: Any = json.loads(path.read_text(encoding="utf-8"))
            wanted = {item.name for item in fields(cls)}
            if not isinstance(data, dict) or set(data) != wanted:
                differing = ", ".join(sorted(wanted.symmetric_difference(data)))
                raise ValueError(f"missing or unknown fields: {differing}")
            plan = cls(**{**data, "kind": AutopilotKind(data["kind"]), "home": GeoPoint(**data["home"])})
            if plan.scenario not in FLIGHTS:
                raise ValueError(f"scenario: unknown name {plan.scenario!r}")
        except (OSError, TypeError, ValueError) as why:
            raise ConfigError(f"is no plan of a flight: {why}", where=str(path), remedy="write it with ServerPlan.save") from why
        return plan

    def save(self, path: Path) -> None:
        """Write the plan as JSON."""
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    def setup(self) -> FlightSetup:
        """The flight that is asked for."""
        area = FlightArea(self.home, self.reach_m, self.gsd_m, self.turn_rad)
        return FlightSetup(FLIGHTS[self.scenario], area, self.kind, self.vehicle, self.seed)


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, pilot: BuiltInAutopilot) -> None:
        self._pilot = pilot

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if not self._pilot.faults.link_down(self._pilot.t_s):
            self._pilot.receive(data)

    def error_received(self, exc: Exception) -> None:
        """The daemon is not listening yet; it will be sent the next packet all the same."""


class SimulationServer:
    """Steps the autopilot (`pilot`) with the clock and serves whoever connects. Raises MapError for a scene that is none,
    ConfigError for a scenario with faults of the companion itself, which this process cannot act out."""

    def __init__(self, plan: ServerPlan) -> None:
        setup = plan.setup()
        _require_faults_of_ours(plan.scenario, setup.scenario.faults)
        self._plan, self._duration_s = plan, setup.scenario.duration_s
        self._clock = MonotonicClock(plan.speed)
        self.pilot = setup.autopilot(boot_age_s=3.0)
        scene = Scene.load(Path(plan.ortho), Path(plan.dsm) if plan.dsm else None, plan.home.h_amsl_m)
        self._camera = simulated_camera(setup, scene)
        self._viewers: dict[asyncio.Task[Any], asyncio.StreamWriter] = {}
        self._truth: list[list[float]] = []
        self._start_ns = 0
        self._stepped_ns: int | None = None
        self._frame_id = 0

    async def run(self) -> None:
        """Fly the scenario to its end and write the result."""
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(
            lambda: _Datagrams(self.pilot), remote_addr=("127.0.0.1", self._plan.mavlink_port)
        )
        server = await asyncio.start_server(self._view, "127.0.0.1", self._plan.camera_port)
        try:
            async with asyncio.TaskGroup() as group:
                frames = group.create_task(self._frames())
                await self._fly(transport)
                frames.cancel()
        finally:
            server.close()
            await self._dismiss_viewers()
            transport.close()
        self._write_result()

    def advance_to(self, now_ns: int) -> None:
        """Step the autopilot to a time of the clock, up to a step of physics behind it; the first call starts the flight.

        However late the call comes, the flight is at most two steps of physics longer than the scenario.
        """
        since_ns, self._stepped_ns = self._stepped_ns, now_ns
        self._start_ns = now_ns if since_ns is None else self._start_ns
        passed_s = 0.0 if since_ns is None else (now_ns - since_ns) / 1e9
        self.pilot.step(min(passed_s, self._duration_s - self.pilot.t_s + PHYSICS_DT_S))

    async def _fly(self, transport: asyncio.DatagramTransport) -> None:
        next_truth_ns = self._clock.now_ns()
        while self.pilot.t_s < self._duration_s:
            now_ns = self._clock.now_ns()
            self.advance_to(now_ns)
            outgoing = self.pilot.outgoing()
            for packet in [] if self.pilot.faults.link_down(self.pilot.t_s) else _datagrams(outgoing):
                transport.sendto(packet)
            if now_ns >= next_truth_ns:
                next_truth_ns += TRUTH_NS
                self._note_truth()
            await asyncio.sleep(WAKE_S)

    async def _frames(self) -> None:
        period_ns = round(1e9 / self._plan.frame_rate_hz)
        due_ns = self._clock.now_ns()
        pixels: Image | None = None
        view: tuple[GeoPoint, Quat, Shot] | None = None
        while True:
            await self._clock.sleep_until(due_ns)
            due_ns = max(due_ns + period_ns, self._clock.now_ns())
            pilot = self.pilot
            if pilot.faults.camera_silent(pilot.t_s) or not self._viewers:
                continue
            truth, t_boot_ns, optics = pilot.truth(), pilot.t_boot_ns, pilot.faults.optics(pilot.t_s)
            self._frame_id += 1
            late_s = pilot.faults.frame_delay_s(pilot.t_s, self._frame_id, self._plan.seed)
            if view is None or not pilot.faults.camera_frozen(pilot.t_s):
                q_ned_carrier, rate_radps = pilot.camera_carrier()
                shot = Shot(truth.v_ned_mps, rate_radps, optics.readout_s, optics.exposure_s, optics.effects)
                view, pixels = (truth.place, q_ned_carrier, shot), None
            if pixels is None or pilot.faults.camera_anew(pilot.t_s):
                place, q_ned_carrier, shot = view
                pixels = await asyncio.to_thread(self._camera.render, place, q_ned_carrier, self._frame_id, shot)
            data = encode_frame(StreamedFrame(pixels=pixels, t_us=t_boot_ns // 1000, autopilot_clock=True))
            if late_s:
                asyncio.get_running_loop().call_later(late_s / self._plan.speed, self._deliver, data)
            else:
                self._deliver(data)

    def _deliver(self, data: bytes) -> None:
        for viewer in self._viewers.values():
            if viewer.transport.get_write_buffer_size() == 0:
                viewer.write(data)

    async def _view(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """A viewer stays until it hangs up; one that has not taken its last frame yet is not given the next."""
        task = asyncio.current_task()
        assert task is not None
        self._viewers[task] = writer
        try:
            with contextlib.suppress(ConnectionError):
                await reader.read()
        finally:
            del self._viewers[task]
            writer.close()

    async def _dismiss_viewers(self) -> None:
        """Hang up and let the viewers' tasks end: one that is still reading when the loop ends is cancelled noisily."""
        viewers = dict(self._viewers)
        for writer in viewers.values():
            writer.transport.abort()
        await asyncio.gather(*viewers)

    def _note_truth(self) -> None:
        place, t_ns = self.pilot.truth().place, self._start_ns + round(self.pilot.t_s * 1e9)
        self._truth.append([t_ns, place.lat_deg, place.lon_deg, place.h_amsl_m])

    def _write_result(self) -> None:
        result = {"truth": self._truth, "failsafe": self.pilot.failsafe, "pulled_m": self.pilot.pulled_m}
        write_result(Path(self._plan.result), json.dumps(result).encode())


def _require_faults_of_ours(scenario: str, faults: FaultSchedule) -> None:
    """Raise ConfigError for faults of the companion's own clock and processes: the daemon beside this one would know of none."""
    own = sorted({type(fault).__name__ for fault in faults.faults if isinstance(fault, CompanionClockStep | WorkerCrash)})
    if own:
        raise ConfigError(
            f"scenario: {scenario!r} holds {', '.join(own)}, faults of the companion, which is another process here",
            where="sim.server",
            remedy=f"fly it in one process: visloc sim --scenario {scenario}",
        )


def _datagrams(data: bytes, limit: int = 1200) -> list[bytes]:
    return [data[k : k + limit] for k in range(0, len(data), limit)]


def main(arguments: list[str]) -> None:
    """Fly the plan that the only argument names; what is wrong with it becomes one line and exit code 2."""
    try:
        if len(arguments) != 1:
            raise ConfigError("needs one argument", where="sim.server", remedy="name a file that ServerPlan.save wrote")
        asyncio.run(SimulationServer(ServerPlan.load(Path(arguments[0]))).run())
    except VislocError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(2)


if __name__ == "__main__":
    main(sys.argv[1:])
