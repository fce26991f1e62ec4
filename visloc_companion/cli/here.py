"""`visloc here`: tell a daemon in flight where the vehicle is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from visloc_companion.adapters.mavlink.signing import SigningSettings


def here(
    at: Annotated[str, typer.Argument(metavar="LAT,LON", help="Where the vehicle is, degrees.")],
    link: Annotated[str, typer.Option("--link", metavar="URL", help="The ground station's link: udpin:HOST:PORT, serial:...")],
    sigma: Annotated[float, typer.Option("--sigma", help="How well that is known: 1-sigma radius in metres.")] = 50.0,
    system: Annotated[int, typer.Option("--system", min=1, max=255, help="Speak as this system (link.operator_systems).")] = 255,
    component: Annotated[int, typer.Option("--component", min=1, max=255, help="The daemon's link.component_id.")] = 197,
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="The key of link.signing_key_file.")] = None,
) -> None:
    """Say where the vehicle is: the daemon looks there and believes it when it finds it. Exit codes: 0 taken, 2 usage, 4 not."""
    import asyncio

    from visloc_companion.adapters.mavlink.operator_call import Caller, say_here
    from visloc_companion.adapters.mavlink.pymavlink_link import open_own_channel
    from visloc_companion.app.first_position import At
    from visloc_companion.types import GeoPoint

    where = At.parsed(at, sigma, where="LAT,LON")
    caller = Caller(system, component, None if key is None else _signing(key))
    place = GeoPoint(where.lat_deg, where.lon_deg, 0.0)
    said = asyncio.run(say_here(link, place, where.sigma_m, caller, open_own_channel))
    sys.stdout.write(f"{said}\n")
    raise typer.Exit(4 if "refused" in said else 0)


def _signing(key: Path) -> SigningSettings:
    import time

    from visloc_companion.adapters.mavlink.signing import SigningSettings, stamp_at_zero
    from visloc_companion.adapters.mavlink.signing_key import read_key

    return SigningSettings(read_key(key), stamp_at_zero=stamp_at_zero(time.time_ns(), time.monotonic_ns()))
