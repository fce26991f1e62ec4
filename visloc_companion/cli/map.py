"""`visloc map`: build, describe and check map packs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from visloc_companion.cli.map_features import (
    FinestFeatures,
    Model,
    OtherDates,
    chosen_networks,
    described_cloud,
    described_date,
    described_features,
    echo_features,
    features,
    stages,
)
from visloc_companion.cli.map_sign import (
    PassphraseFile,
    SignKey,
    TrustedKeys,
    chosen_signer,
    described_signature,
    hashes_bar,
    make_key,
    sign,
    signature_info,
)
from visloc_companion.errors import ConfigError
from visloc_companion.prepare.defaults import FINEST_FEATURES_M

if TYPE_CHECKING:
    from visloc_companion.maps.pack import PackMap

map_app = typer.Typer(help="Build, describe and check map packs.", no_args_is_help=True)
MANY = ("--ortho", "--other-dates", "--dsm", "--cloud")
Pack = Annotated[Path, typer.Argument(metavar="PACK", help="Folder of the pack.")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result here.")]


class ManyFiles(TyperCommand):
    """Takes `--ortho A B C` for `--ortho A --ortho B --ortho C`, as shells expand `--ortho *.tif`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments with the options repeated."""
        return super().parse_args(ctx, repeated(args))


def repeated(args: Sequence[str]) -> list[str]:
    """Arguments in which each further value of an option in MANY has the option before it."""
    out: list[str] = []
    option = ""
    for arg in args:
        if arg.startswith("-"):
            option = arg.split("=", 1)[0]
        elif option in MANY and out[-1] != option:
            out.append(option)
        out.append(arg)
    return out


map_app.command(cls=ManyFiles)(features)
map_app.command("key")(make_key)
map_app.command()(sign)


@map_app.command(cls=ManyFiles)
def build(
    ortho: Annotated[list[Path], typer.Option(metavar="FILE...", help="Orthophotos (GeoTIFF); the first lies on top.")],
    out: Annotated[Path, typer.Option(metavar="PACK", help="Folder to make; an existing pack is replaced.")],
    other_dates: OtherDates = None,
    dsm: Annotated[
        list[Path] | None, typer.Option(metavar="FILE...", help="Surface models (GeoTIFF); the first lies on top.")
    ] = None,
    cloud: Annotated[
        list[Path] | None, typer.Option(metavar="FILE...", help="Point clouds (.las, .laz): kept, and the surface without --dsm.")
    ] = None,
    cloud_crs: Annotated[str, typer.Option(metavar="EPSG:CODE", help="CRS of clouds that state none.")] = "",
    name: Annotated[str, typer.Option(help="Name of the pack; the folder's by default.")] = "",
    source: Annotated[str, typer.Option(help="Where the imagery comes from.")] = "",
    licence: Annotated[str, typer.Option(help="Licence of the imagery.")] = "",
    capture_date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="When it was taken.")] = "",
    ground_height_m: Annotated[
        float | None, typer.Option(help="Height of the ground above sea level where there is no surface model; else 0.")
    ] = None,
    vertical_datum: Annotated[str, typer.Option(metavar="amsl|ellipsoidal", help="What the surface's heights are above.")] = "",
    geoid_undulation_m: Annotated[
        float | None, typer.Option(help="Geoid above the ellipsoid there, for ellipsoidal heights.")
    ] = None,
    model: Model = "",
    finest_features_m: FinestFeatures = FINEST_FEATURES_M,
    sign_key: SignKey = None,
    passphrase_file: PassphraseFile = None,
    json_file: Json = None,
) -> None:
    """Make a pack from orthophotos, a surface model and point clouds."""
    from visloc_companion.cli.progress import require_folder, write_json
    from visloc_companion.maps.fills import HEIGHTS_M
    from visloc_companion.maps.manifest import MANIFEST
    from visloc_companion.maps.pack import PackMap
    from visloc_companion.maps.registration import registration_warnings
    from visloc_companion.prepare.build import build_pack
    from visloc_companion.prepare.check import cloud_info, pole_warnings
    from visloc_companion.prepare.dates import bent_dates
    from visloc_companion.prepare.heights import (
        cloud_above_at_places,
        described_plane,
        described_range,
        described_undulation,
        heights_warnings,
        surface_range,
        undulation_warnings,
    )

    _check_date(capture_date)
    ground_h_amsl_m = 0.0 if ground_height_m is None else ground_height_m
    if not HEIGHTS_M[0] <= ground_h_amsl_m <= HEIGHTS_M[1]:
        raise ConfigError(f"--ground-height-m: no ground is at {ground_h_amsl_m:g} m", remedy="name its height above sea level")
    require_folder(json_file, "--json", *ortho, *(other_dates or ()), *(dsm or ()), *(cloud or ()), out / MANIFEST)
    signer = chosen_signer(sign_key, passphrase_file)
    networks = chosen_networks(model)
    built = out.resolve()  # a pack that is the working folder is another folder when it is built
    seams: list[str] = []
    with stages() as report:
        manifest = build_pack(
            ortho,
            dsm,
            out,
            other_dates=other_dates or (),
            clouds=cloud or (),
            cloud_crs=cloud_crs,
            name=name,
            source=source,
            licence=licence,
            capture_date=capture_date,
            ground_h_amsl_m=ground_h_amsl_m,
            vertical_datum=_datum(vertical_datum),
            geoid_undulation_m=geoid_undulation_m,
            networks=networks,
            finest_features_m=finest_features_m,
            sign=None if signer is None else signer.sign,
            progress=report,
            warn=seams.append,
        )
    if json_file is not None:
        write_json(json_file, {"schema": 1, "folder": str(out), "manifest": manifest.model_dump(mode="json")})
    size_mb = sum(entry.bytes for entry in manifest.files.values()) / 1e6
    pixels = f"{manifest.ortho.cols} x {manifest.ortho.rows} px at {manifest.gsd_m:.3g} m"
    typer.echo(f"{out}: {pixels}, {manifest.crs.name}, {size_mb:.1f} MB")
    typer.echo(f"content on {manifest.share_valid:.1%} of it")
    if signer is not None:
        typer.echo(f"signed by the key {signer.public.fingerprint}")
    for each in manifest.other_dates:
        typer.echo(f"other date {described_date(each)}")
    echo_features(manifest)
    pack = PackMap.open(built, verify_hashes=False)
    if (surface := surface_range(pack)) is not None:
        typer.echo(f"surface {described_range(surface)}{described_undulation(manifest.heights)}")
    if manifest.heights.grid is None:
        unstated = (
            ", for want of --dsm, --cloud and --ground-height-m: frames are scaled by it" if ground_height_m is None else ""
        )
        typer.echo(f"ground {described_plane(manifest.heights)}{unstated}")
    if (points := cloud_info(manifest)) is not None:
        typer.echo(f"cloud {described_cloud(points)}")
    for warning in (
        *registration_warnings(ortho),
        *seams,
        *bent_dates(manifest.other_dates, manifest.gsd_m),
        *heights_warnings(cloud_above_at_places(pack)),
        *undulation_warnings(manifest.heights, surface, ground_height_m),
        *pole_warnings(manifest.bounds),
    ):
        typer.echo(f"warning: {warning}", err=True)
    if manifest.heights.share_known < 0.9995:
        typer.echo(f"warning: {1 - manifest.heights.share_known:.1%} of it has no height and will not be used", err=True)


@map_app.command()
def info(pack: Pack, trusted_key: TrustedKeys = None, json_file: Json = None) -> None:
    """Say what a pack holds; hashes are not checked."""
    from visloc_companion.cli.progress import require_folder, write_json
    from visloc_companion.maps.manifest import MANIFEST
    from visloc_companion.maps.pack import PackMap
    from visloc_companion.maps.signature import public_keys
    from visloc_companion.prepare.check import pack_info

    require_folder(json_file, "--json", pack, pack / MANIFEST, *(trusted_key or ()))
    trusted = trusted_key or []
    opened = PackMap.open(pack, verify_hashes=False, trusted=public_keys(trusted, "--trusted-key"))
    result = pack_info(opened, pack) | {"signature": signature_info(pack, trusted)}
    if json_file is not None:
        write_json(json_file, result)
    for key, value in _described(result):
        typer.echo(f"{key:16} {value}")


@map_app.command()
def check(
    pack: Pack,
    route: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV (lat_deg,lon_deg), .waypoints or .plan.")] = None,
    margin_m: Annotated[float, typer.Option(min=0, max=100_000, help="How far around the route the map must reach.")] = 0.0,
    model: Model = "",
    trusted_key: TrustedKeys = None,
    json_file: Json = None,
) -> None:
    """Check hashes, signature, how much can be matched, and whether a route stays on the map (exit code 1 if not)."""
    from visloc_companion.cli.progress import require_folder, write_json
    from visloc_companion.maps.manifest import MANIFEST
    from visloc_companion.prepare.check import check_pack
    from visloc_companion.prepare.heights import described_plane, described_range

    require_folder(json_file, "--json", route, pack, pack / MANIFEST, *(trusted_key or ()))
    trusted = trusted_key or []
    verified = _verified(pack, trusted)
    signature = signature_info(pack, trusted)
    result = check_pack(verified, route, margin_m, chosen_networks(model)) | {"signature": signature}
    if json_file is not None:
        write_json(json_file, result)
    cells = result["matchability"]
    typer.echo(f"{result['files']} files are as built, content on {result['share_valid']:.1%} of the map")
    if signature["key"] is not None:
        typer.echo(f"signed {described_signature(signature)}")
    if result["surface"] is not None:
        typer.echo(f"surface {described_range(result['surface'])}")
    if verified.manifest.heights.grid is None:
        typer.echo(f"ground {described_plane(verified.manifest.heights)}")
    typer.echo(f"{cells['share_matchable']:.0%} of {cells['cells']} cells of {cells['cell_m']:.0f} m can be matched")
    if "route" in result:
        leg = result["route"]
        typer.echo(f"route of {leg['length_m'] / 1000:.2f} km: {leg['points_outside']} of {leg['points']} points off the map")
        without = f"{leg['longest_unmatchable_m'] / 1000:.2f} km on end at most without such"
        typer.echo(f"{leg['share_matchable']:.0%} of it over ground that can be matched, {without}")
    for warning in result["warnings"]:
        typer.echo(f"warning: {warning}")
    if not result["passed"]:
        place = result["route"]["first_outside"]
        typer.echo(f"the route leaves the map at {place['lat_deg']:.6f}, {place['lon_deg']:.6f}")
        raise typer.Exit(1)


def _verified(folder: Path, trusted_keys: Sequence[Path]) -> PackMap:
    from visloc_companion.maps.pack import PackMap
    from visloc_companion.maps.signature import public_keys, read_signed
    from visloc_companion.maps.verify import verify_files

    trusted = public_keys(trusted_keys, "--trusted-key")
    manifest = read_signed(folder, trusted)
    with hashes_bar(manifest) as checked:
        verify_files(folder, manifest, progress=checked)
    return PackMap.open(folder, verify_hashes=False, trusted=trusted)


def _datum(text: str) -> Literal["amsl", "ellipsoidal"] | None:
    if text == "":
        return None
    if text == "amsl":
        return "amsl"
    if text == "ellipsoidal":
        return "ellipsoidal"
    raise ConfigError(f"--vertical-datum: unknown {text!r}", remedy="amsl or ellipsoidal")


def _check_date(text: str) -> None:
    from datetime import UTC, date, datetime, timedelta

    if not text:
        return
    try:
        taken = date.fromisoformat(text)
    except ValueError:
        taken = None
    if taken is None or taken.isoformat() != text:
        raise ConfigError(f"--capture-date: {text!r} is no date", remedy="write it as YYYY-MM-DD")
    if taken > datetime.now(tz=UTC).date() + timedelta(days=1):
        raise ConfigError(f"--capture-date: {text} is still to come", remedy="correct it, or the clock of this computer")


def _described(result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    from visloc_companion.maps.manifest import HeightEntry, OtherDate
    from visloc_companion.prepare.heights import described_plane, described_range, described_undulation

    manifest = result["manifest"]
    bounds, heights = manifest["bounds"], manifest["heights"]
    yield "name", manifest["name"]
    yield "CRS", manifest["crs"]["name"] + (f" (EPSG:{manifest['crs']['epsg']})" if manifest["crs"]["epsg"] else "")
    accuracy_m = result["crs_accuracy_m"]
    tied = "not stated how well" if accuracy_m is None else f"to {accuracy_m:g} m" if accuracy_m else "by its nature"
    changed = ", ".join(each["name"] for each in manifest["reprojected_from"])
    yield "tied to WGS 84", tied + (f", reprojected from {changed}" if changed else "")
    yield "pixels", f"{manifest['ortho']['cols']} x {manifest['ortho']['rows']} at {manifest['gsd_m']:.4g} m"
    yield "latitude", f"{bounds['south_deg']:.6f} to {bounds['north_deg']:.6f}"
    yield "longitude", f"{bounds['west_deg']:.6f} to {bounds['east_deg']:.6f}"
    yield "with content", f"{manifest['share_valid']:.1%}"
    if heights["grid"] is None:
        yield "heights", described_plane(HeightEntry.model_validate(heights))
    else:
        grid = heights["grid"]
        made = f"made from {heights['source_datum']} heights{described_undulation(HeightEntry.model_validate(heights))}"
        known = f", known on {heights['share_known']:.1%} of the map" if heights["share_known"] < 1 else ""
        yield "heights", f"{described_range(result['surface'])}, {made}{known}"
        yield "surface pixels", f"{grid['cols']} x {grid['rows']} at {grid['transform'][0]:.4g} m"
    if result["cloud"] is not None:
        yield "cloud", described_cloud(result["cloud"])
    for each in result["features"]:
        yield "features", described_features(each)
    yield "capture date", manifest["capture_date"] or "not stated"
    for each in manifest["other_dates"]:
        yield "other date", described_date(OtherDate.model_validate(each))
    yield "source", manifest["source"] or "not stated"
    yield "licence", manifest["licence"] or "not stated"
    yield "signature", described_signature(result["signature"])
    yield "size", f"{result['bytes'] / 1e6:.1f} MB in {len(manifest['files'])} files"
