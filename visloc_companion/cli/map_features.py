"""`visloc map features`, and what `build` and `check` share with it: which networks, how they are described, the bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from visloc_companion.cli.map_sign import PassphraseFile, SignKey, chosen_signer
from visloc_companion.errors import ConfigError
from visloc_companion.prepare.defaults import FINEST_FEATURES_M

if TYPE_CHECKING:
    from visloc_companion.localise.features.base import Features
    from visloc_companion.maps.manifest import Manifest, OtherDate

NO_MODEL = "none"
Model = Annotated[
    str,
    typer.Option(
        metavar=f"DIR|{NO_MODEL}", help="Network whose features the pack holds; the one that came with this version by default."
    ),
]
FinestFeatures = Annotated[
    float,
    typer.Option(
        min=0, max=1000, help="Store a network's features from about this GSD (metres) on; finer ones are computed in flight."
    ),
]
OtherDates = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE...", help="Orthophotos of other dates (GeoTIFF, each a date): the features are the mean over all dates."
    ),
]


def features(
    pack: Annotated[Path, typer.Argument(metavar="PACK", help="Folder of the pack.")],
    model: Model = "",
    other_dates: OtherDates = None,
    finest_features_m: FinestFeatures = FINEST_FEATURES_M,
    replace: Annotated[bool, typer.Option("--replace", help="Drop the features of other networks.")] = False,
    sign_key: SignKey = None,
    passphrase_file: PassphraseFile = None,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result here.")] = None,
) -> None:
    """Store a network's features in a pack that exists; the old one stays as it is until the new one is whole. A signature is
    not kept, as the manifest is another one: sign again."""
    from visloc_companion.cli.progress import require_folder, write_json
    from visloc_companion.maps.manifest import MANIFEST
    from visloc_companion.maps.signature import SIGNATURE
    from visloc_companion.prepare.add_features import add_features

    if model == NO_MODEL and not replace:
        raise ConfigError(f"--model {NO_MODEL} stores nothing", remedy="name a model, or drop all networks' with --replace")
    require_folder(json_file, "--json", pack, pack / MANIFEST, *(other_dates or ()))
    signer = chosen_signer(sign_key, passphrase_file)
    networks = () if model == NO_MODEL else (_opened(model),)
    was_signed = (pack / SIGNATURE).exists()
    with stages() as report:
        manifest = add_features(
            pack,
            networks,
            other_dates=other_dates or (),
            finest_features_m=finest_features_m,
            replace=replace,
            signer=signer,
            progress=report,
        )
    if json_file is not None:
        write_json(json_file, {"schema": 1, "folder": str(pack), "manifest": manifest.model_dump(mode="json")})
    echo_features(manifest)
    if signer is not None:
        typer.echo(f"signed by the key {signer.public.fingerprint}")
    elif was_signed:
        typer.echo(f"warning: the manifest has changed, so its signature is gone: visloc map sign {pack} --key FILE", err=True)


def chosen_networks(model: str) -> tuple[Features, ...]:
    """The network that `--model` names; none, with a warning, where none is named and this version's cannot be opened.

    Raises ModelError or ConfigError for a named one that cannot be opened.
    """
    if model == NO_MODEL:
        return ()
    if model:
        return (_opened(model),)
    from visloc_companion.prepare.shipped import shipped_networks

    networks, why = shipped_networks()
    if why:
        typer.echo(f"warning: no network's features: {why}", err=True)
    return networks


def echo_features(manifest: Manifest) -> None:
    """One line for each function whose features a pack holds."""
    from visloc_companion.prepare.check import features_info

    for each in features_info(manifest):
        typer.echo(f"features {described_features(each)}")


def described_features(each: dict[str, Any]) -> str:
    """Name, GSDs and size of one function's features."""
    gsds = f"{each['gsd_m'][0]:.3g} m" + (f" to {each['gsd_m'][-1]:.3g} m" if len(each["gsd_m"]) > 1 else "")
    of = f", mean over {each['n_dates']} dates" if each["n_dates"] > 1 else ""
    size = f"{each['bytes'] / 1e6:.1f} MB, {each['bytes_per_km2'] / 1e6:.3g} MB/km²"
    return f"{each['name']} {gsds} in {len(each['gsd_m'])} levels, {each['channels']} channels, {size}{of}"


def described_date(each: OtherDate) -> str:
    """Its file, and how it was moved to lie on the map's own picture."""
    east_m, north_m = each.moved_east_m, each.moved_north_m
    if east_m == north_m == 0.0:
        return f"{each.inputs[0].file}, which lies on the first"
    way = (
        f"{abs(north_m):.2f} m {'north' if north_m >= 0 else 'south'} and {abs(east_m):.2f} m {'east' if east_m >= 0 else 'west'}"
    )
    return f"{each.inputs[0].file}, moved {way} to lie on the first"


def described_cloud(each: dict[str, Any]) -> str:
    """Points, their density, what they cover, and size."""
    points = f"{each['points']} points, {each['points_per_m2']:.3g} a square metre on {each['share_covered']:.1%} of the map"
    return f"{points}, {each['bytes'] / 1e6:.1f} MB"


@contextmanager
def stages() -> Iterator[Callable[[str, float], None]]:
    """One bar for each stage of the work, on stderr."""
    from visloc_companion.cli.progress import bar

    with ExitStack() as open_bar:
        advance: Callable[[float], None] | None = None
        current = ""

        def report(stage: str, share: float) -> None:
            nonlocal advance, current
            if stage != current or advance is None:
                open_bar.pop_all().close()
                advance, current = open_bar.enter_context(bar(stage, 1.0)), stage
            advance(share)

        yield report


def _opened(model: str) -> Features:
    from visloc_companion.localise.features.onnx import open_features

    return open_features(Path(model) if model else None)
