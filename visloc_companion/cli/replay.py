"""`visloc replay`: a recorded flight once more, through the navigator of today."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from visloc_companion.cli.replay_sources import Source
    from visloc_companion.evaluate.gate import Check
    from visloc_companion.evaluate.record import FlightRecord


def replay(
    flight: Annotated[Path, typer.Argument(help="A .tlog, .bin, .ulg or .mcap file, or a folder with telemetry.* and frames.")],
    pack: Annotated[Path | None, typer.Option("--map", help="Map pack; with it the frames are localised.")] = None,
    config: Annotated[Path | None, typer.Option("--config", help="Configuration (TOML); a journal brings its own.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for report.html and epochs.csv.")] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the figures as JSON.")] = None,
    gate: Annotated[str, typer.Option("--gate", help='Conditions, as in "hmi=0,p95_m<=12"; exit code 1 where one fails.')] = "",
    speed: Annotated[str, typer.Option("--speed", help="max, or 1 for real time.")] = "max",
    alert_limit_m: Annotated[
        float, typer.Option("--alert-limit", min=0.1, max=10_000, help="Alert limit of HMI, metres.")
    ] = 25.0,
    rerun: Annotated[
        bool,
        typer.Option("--rerun", help="Localise a journal's recorded frames anew, with this version, --config and --map."),
    ] = False,
    salvage: Annotated[bool, typer.Option("--salvage", help="Read a damaged journal as far as it goes.")] = False,
    system_id: Annotated[
        int, typer.Option("--system-id", min=0, max=255, help="Vehicle of a telemetry log; 0: the one heard most.")
    ] = 0,
    boot: Annotated[int, typer.Option("--boot", min=0, help="Which boot of an on-board log; 0: the one that tells most.")] = 0,
) -> None:
    """Replay a flight: GNSS verdicts and dead reckoning, with frames and a map its fixes, of a journal also its commands.

    A journal's recorded answers are taken as they are, or with --rerun made anew from its recorded frames.

    Exit codes: 0 ok, 1 the gate failed or a journal's commands differ or are gone, 2 usage or configuration, 3 bad data.
    """
    from visloc_companion.cli.progress import make_folder, require_folder, write_json
    from visloc_companion.cli.read_once import read_once
    from visloc_companion.cli.replay_sources import open_source
    from visloc_companion.evaluate.gate import check_gate, parse_gate
    from visloc_companion.evaluate.metrics import flight_summary

    parse_gate(gate)
    make_folder(out, "--out")
    require_folder(
        json, "--json", flight, pack, config, *(out / name for name in ("epochs.csv", "report.html") if out is not None)
    )
    with read_once():
        source = open_source(flight, pack, config, salvage, _speed(speed), system_id, boot, rerun=rerun)
    record = source.record()
    epochs = str(out / "epochs.csv") if out is not None else None
    summary = flight_summary(record, alert_limit_m=alert_limit_m, latency=source.latency, epochs=epochs)
    summary |= {"flight": str(flight), **source.facts()}
    checks = [*source.checks(), *check_gate(gate, summary)]
    reported = None
    try:
        if out is not None:
            _write_results(out, flight, source, record, checks, alert_limit_m)
            reported = out
    finally:  # a full disk must not cost an hour's figures
        try:
            _tell(source, summary, checks, reported)
        finally:  # nor a reader of the words that went away
            if json is not None:
                write_json(json, summary if reported else summary | {"epochs": None})
    if not all(check.passed for check in checks):
        raise typer.Exit(1)


def _speed(text: str) -> float | None:
    from visloc_companion.errors import ConfigError

    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < 1e6:
        raise ConfigError(f"{text!r} is no speed", where="--speed", remedy="use max, or 1 for real time")
    return speed


def _write_results(
    out: Path, flight: Path, source: Source, record: FlightRecord, checks: list[Check], alert_limit_m: float
) -> None:
    from visloc_companion.cli.progress import results_into
    from visloc_companion.evaluate.metrics import write_epochs
    from visloc_companion.evaluate.report import write_flight_report

    map_image = source.map_image(record)
    with results_into(out, "--out"):
        write_epochs(record, out / "epochs.csv")
        write_flight_report(
            record,
            out / "report.html",
            title=f"Replay of {flight.name}",
            checks=checks,
            map_image=map_image,
            alert_limit_m=alert_limit_m,
            notes=source.notes(),
            latency=source.latency,
        )


def _tell(source: Source, summary: dict[str, Any], checks: list[Check], out: Path | None) -> None:
    gnss, error, injected = summary["gnss"], summary["error_horizontal_m"], summary["injected"]
    lines = [
        f"{summary['flight']}: {summary['duration_s']:.0f} s, {summary['n_frames']} frames, {summary['n_fixes']} fixes, "
        f"{summary['n_no_fix']} without, {injected['n']} injections",
        f"GNSS: {_verdicts(summary['verdicts'])}",
        f"modes: {_verdicts(summary['modes'])}",
    ]
    if error["median"] is not None:
        lines.append(f"error: median {error['median']:.2f} m, 95 % {error['p95']:.2f} m, maximum {error['max']:.2f} m")
        judged, false = summary["integrity"]["horizontal"], gnss["false_alarms"]
        lines.append(
            f"of {judged['epochs'] if judged else 0} epochs with truth: HMI {summary['hmi']}, "
            f"misleading {summary['misleading']}; false alarms {'not known' if false is None else false}"
        )
    lines += [*source.notes()]
    if out is not None:
        lines.append(f"report: {out / 'report.html'}")
    lines += [f"{'ok' if c.passed else 'FAILED'}: {c.name} {c.limit} ({_found(c)})" for c in checks]
    typer.echo("\n".join(lines))


def _found(check: Check) -> str:
    if check.value is None:
        return "there is none: it comes of a truth beside the flight, of fixes, positions sent or an alarm"
    return f"is {check.value}"


def _verdicts(changes: list[tuple[float, str]]) -> str:
    shown = [f"{name} from {t_s:.1f} s" for t_s, name in changes[:8]]
    return ", ".join(shown) + (f", and {len(changes) - 8} more changes" if len(changes) > 8 else "") if shown else "none"
