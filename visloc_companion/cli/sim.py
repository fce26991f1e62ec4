"""`visloc sim`: closed-loop flights over a map with the built-in autopilot, in simulated time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from visloc_companion.cli.evaluate import DEFAULT_METHOD
from visloc_companion.errors import ConfigError

if TYPE_CHECKING:
    from visloc_companion.evaluate.campaign import FlightSpec
    from visloc_companion.evaluate.closed_loop import FlownScenario
    from visloc_companion.evaluate.sim_journal import JournalChoice

WORLD_SEED = 1
_OF_BUILT_IN = (
    "map_pack camera_ortho camera_dsm dialect method without_structure gimbal report journal record_frames campaign jobs"
)
_OF_CAMPAIGN = "dialect vehicle seed"


def sim(
    ctx: typer.Context,
    scenario: Annotated[str, typer.Option(help="Name of the flight; --list shows them.")] = "",
    map_pack: Annotated[Path | None, typer.Option("--map", help="Map pack; without it the embedded procedural world.")] = None,
    camera_ortho: Annotated[
        Path | None, typer.Option(help="Orthophoto of another date, for the camera; else the map's own.")
    ] = None,
    camera_dsm: Annotated[Path | None, typer.Option(help="Surface model of that date; without it the pack's.")] = None,
    autopilot: Annotated[str, typer.Option(help="built-in, ardupilot or px4.")] = "built-in",
    dialect: Annotated[str, typer.Option(help="What the built-in autopilot behaves like: ardupilot or px4.")] = "ardupilot",
    vehicle: Annotated[str, typer.Option(help="copter or plane.")] = "copter",
    seed: Annotated[int, typer.Option(help="Feeds wind, noise and errors.")] = 1,
    method: Annotated[str, typer.Option(help="Localiser; visloc evaluate image --list-methods names them.")] = DEFAULT_METHOD,
    without_structure: Annotated[
        bool, typer.Option("--without-structure", help="Never ask for the structure vote, whatever the image fails at.")
    ] = False,
    gimbal: Annotated[
        bool, typer.Option("--gimbal", help="A gimbal that points straight down carries the camera, not the airframe.")
    ] = False,
    without_daemon: Annotated[bool, typer.Option("--without-daemon", help="The same flight, nobody helping.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the result here, and one flight's epochs beside it as CSV.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write an HTML report here.")] = None,
    journal: Annotated[
        Path | None, typer.Option(help="Write the flight's journal here, as the daemon would: for visloc replay and visloc web.")
    ] = None,
    record_frames: Annotated[
        bool, typer.Option("--record-frames", help="With --journal: the frames that are localised, too.")
    ] = False,
    campaign: Annotated[str, typer.Option(help="Many flights: a name (--list) or a JSON file.")] = "",
    jobs: Annotated[int, typer.Option(min=1, help="Flights of --campaign at a time.")] = 1,
    list_all: Annotated[bool, typer.Option("--list", help="Name scenarios and campaigns, of --autopilot and --vehicle.")] = False,
) -> None:
    """Fly a scenario in simulated time and judge it. Exit code 1 when it does not show what is expected."""
    from dataclasses import replace

    from visloc_companion.cli.progress import require_folder
    from visloc_companion.evaluate.campaign import CAMPAIGNS, FlightSpec, campaign_specs
    from visloc_companion.evaluate.sim_journal import JournalChoice
    from visloc_companion.maps.manifest import MANIFEST

    if list_all:
        _list() if autopilot == "built-in" else _list_real(autopilot, vehicle)
        return
    if autopilot != "built-in":
        from visloc_companion.cli.sim_real import fly_real

        _refuse(ctx, _OF_BUILT_IN, f"means nothing with --autopilot {autopilot}", "leave it out, or fly the built-in autopilot")
        fly_real(autopilot, vehicle, scenario, seed, not without_daemon, json_file)
        return
    if bool(scenario) == bool(campaign):
        raise ConfigError("name either --scenario or --campaign", remedy="visloc sim --list")
    if campaign and report is not None:
        raise ConfigError("--report shows one flight", remedy="give it with --scenario")
    if scenario:
        _refuse(ctx, "jobs", "means nothing with --scenario, which is one flight", "leave it out, or give it with --campaign")
    _check_journal(journal, record_frames, campaign, without_daemon)
    if campaign in CAMPAIGNS:
        _refuse(ctx, _OF_CAMPAIGN, f"is settled by the campaign {campaign}", "name a JSON file with a list of flights")
    read = (map_pack, map_pack and map_pack / MANIFEST, camera_ortho, camera_dsm, Path(campaign) if campaign else None)
    require_folder(json_file, "--json", *read)
    require_folder(report, "--report", *read, json_file)
    require_folder(journal, "--journal", *read, json_file, report)
    nowhere = Path()
    spec = FlightSpec(scenario or "demo", nowhere, nowhere, None, dialect, vehicle, seed, method, not without_daemon)
    spec = replace(spec, structure=not without_structure, gimbal=gimbal)
    specs = _placed(campaign_specs(campaign, spec) if campaign else [spec], map_pack, camera_ortho, camera_dsm)
    if campaign:
        _campaign(specs, jobs, json_file)
    else:
        _single(specs[0], json_file, report, None if journal is None else JournalChoice(journal, record_frames))


def _check_journal(journal: Path | None, frames: bool, campaign: str, without_daemon: bool) -> None:
    if journal is None and frames:
        raise ConfigError("--record-frames goes with --journal", remedy="name the journal's file")
    if journal is not None and campaign:
        raise ConfigError("--journal keeps one flight", remedy="give it with --scenario")
    if journal is not None and without_daemon:
        raise ConfigError("--journal keeps what the daemon does", remedy="leave --without-daemon or --journal out")


def _refuse(ctx: typer.Context, parameters: str, why: str, remedy: str) -> None:
    """What is given and would have no effect is a mistake that shows only after the flight."""
    for param in ctx.command.params:
        source = ctx.get_parameter_source(param.name or "")
        if param.name in parameters.split() and source is not None and source.name == "COMMANDLINE":
            raise ConfigError(f"{param.opts[0]} {why}", remedy=remedy)


def _list() -> None:
    from visloc_companion.evaluate.campaign import CAMPAIGNS
    from visloc_companion.sim.scenarios import FLIGHTS

    for one in FLIGHTS.values():
        typer.echo(f"{one.name:20} {one.duration_s:4.0f} s  {one.summary}")
    for name, (dialects, vehicles, seeds) in CAMPAIGNS.items():
        typer.echo(f"{name:20} campaign of all scenarios: {', '.join(dialects)}; {', '.join(vehicles)}; {len(seeds)} seed(s)")


def _list_real(autopilot: str, vehicle: str) -> None:
    """The flights of a real autopilot's simulator, on stderr those that it cannot fly, and why.

    Raises ConfigError where there is none of such a vehicle."""
    from visloc_companion.cli.sim_real import chosen_simulator
    from visloc_companion.sim.real.scenarios import NAMES, cannot_fly, real_scenario

    simulator = chosen_simulator(autopilot, vehicle)
    for name, summary in NAMES.items():
        why = cannot_fly(name, simulator)
        if why:
            typer.echo(f"not flown by {simulator}: {name} ({why})", err=True)
        else:
            typer.echo(f"{name:20} {real_scenario(name, simulator).duration_s:4.0f} s  {summary}")
    typer.echo("where nothing else is said, GNSS is jammed at 60 s, and 140 s are flown on vision", err=True)


def _placed(
    specs: list[FlightSpec], map_pack: Path | None, camera_ortho: Path | None, camera_dsm: Path | None
) -> list[FlightSpec]:
    """The flights over the map that is given, or over the procedural world on the date of each scenario."""
    from dataclasses import replace

    if map_pack is None and (camera_ortho is not None or camera_dsm is not None):
        what = "--camera-dsm" if camera_ortho is None else "--camera-ortho"
        raise ConfigError(
            f"{what} goes with --map", remedy="name the pack that is flown over, or neither for the procedural world"
        )
    if map_pack is not None:
        return [replace(one, pack=map_pack, camera_ortho=camera_ortho, camera_dsm=camera_dsm) for one in specs]
    from visloc_companion.cli.progress import spinner
    from visloc_companion.evaluate.campaign import find_scenario
    from visloc_companion.prepare.world import procedural_world, scene_on

    with spinner("procedural world") as tell:
        world = procedural_world(WORLD_SEED, on_stage=tell)
        seen = [scene_on(world, find_scenario(one.scenario).date, WORLD_SEED, tell) for one in specs]
    return [
        replace(one, pack=world.pack, camera_ortho=ortho, camera_dsm=dsm) for one, (ortho, dsm) in zip(specs, seen, strict=True)
    ]


def _single(spec: FlightSpec, json_file: Path | None, report: Path | None, kept: JournalChoice | None) -> None:
    from visloc_companion.cli.progress import bar
    from visloc_companion.cli.sim_result import write_result
    from visloc_companion.evaluate.campaign import find_scenario, fly_spec, result_of

    with bar(f"flying {spec.scenario}", find_scenario(spec.scenario).duration_s) as advance:
        flown = fly_spec(spec, advance, kept)
    result = result_of(flown, spec.method, spec.with_daemon, spec.camera_ortho is None)
    try:
        typer.echo(_line(result))
        for check in flown.checks:
            typer.echo(f"  {'ok  ' if check.passed else 'FAIL'} {check.name}: {check.value} (limit {check.limit})")
    finally:  # a reader of the words that went away must not cost the flight
        if json_file is not None:
            write_result(flown.record, result, json_file)
        if report is not None:
            _report(spec, flown, report)
    if not flown.passed:
        raise typer.Exit(1)


def _report(spec: FlightSpec, flown: FlownScenario, path: Path) -> None:
    from dataclasses import replace

    from visloc_companion.cli.progress import result_to
    from visloc_companion.evaluate.campaign import find_scenario, fly_spec
    from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, fault_intervals
    from visloc_companion.evaluate.map_image import map_image
    from visloc_companion.evaluate.report import write_flight_report
    from visloc_companion.maps.pack import PackMap

    carried, seen = ", gimbal" * spec.gimbal, ", same image" * (spec.camera_ortho is None)
    baseline = fly_spec(replace(spec, with_daemon=False)).record if spec.with_daemon else None
    with result_to(path, "--report"):
        write_flight_report(
            flown.record,
            path,
            title=f"{spec.scenario}: {spec.dialect} {spec.vehicle}{carried}, {spec.method}{seen}",
            checks=flown.checks,
            baseline=baseline,
            map_image=map_image(PackMap.open(spec.pack, verify_hashes=False), flown.record, baseline),
            alert_limit_m=ALERT_LIMIT_M,
            gnss_faults_s=fault_intervals(find_scenario(spec.scenario)),
        )


def _campaign(specs: list[FlightSpec], jobs: int, json_file: Path | None) -> None:
    """What was flown before an interruption, or before a flight that raises, is written and told all the same."""
    from contextlib import closing

    from visloc_companion.cli.progress import bar, write_json
    from visloc_companion.evaluate.campaign import FlownSpec, campaign_outcome, fly_campaign
    from visloc_companion.evaluate.ended_in_order import ended_in_order

    flown = list[FlownSpec]()
    try:
        with (
            ended_in_order(),
            bar(f"{len(specs)} flights", len(specs)) as advance,
            closing(fly_campaign(specs, jobs)) as flights,
        ):
            for one in flights:
                flown.append(one)
                advance(len(flown))
                typer.echo(_line(one.result))
    finally:
        if flown:
            outcome = campaign_outcome(flown, len(specs))
            totals = " ".join(f"{name}={value}" for name, value in outcome["totals"].items())
            try:
                typer.echo(totals if outcome["complete"] else f"INCOMPLETE, of {len(specs)} flights: {totals}")
            finally:
                if json_file is not None:
                    write_json(json_file, outcome)
    if not all(one.result["passed"] for one in flown):
        raise typer.Exit(1)


def _line(result: dict[str, Any]) -> str:
    error, bad_s = result["error_horizontal_m"], result["gnss"]["detected_at_s"]
    told = [f"error median {error['median']} max {error['max']} m"] if error["median"] is not None else []
    told.append(f"pulled {result['pulled_m']} m")
    if result["with_daemon"]:
        told.append("GNSS never declared bad" if bad_s is None else f"GNSS declared bad at {bad_s} s")
    how = ", gimbal" * result["gimbal"] + ", same image" * result["same_image"]
    return (
        f"{_word(result)} {result['scenario']} {result['dialect']} {result['vehicle']} "
        f"seed {result['seed']}{how}: {', '.join(told)}, failsafe {result['failsafe'] or 'none'}"
    )


def _word(result: dict[str, Any]) -> str:
    """Nothing is expected of a flight without the daemon, so it neither passes nor fails."""
    if not result["with_daemon"]:
        return "FLOWN"
    return "PASS" if result["passed"] else "FAIL"
