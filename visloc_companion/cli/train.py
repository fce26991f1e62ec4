"""`visloc train`: train feature networks on map dates, and export them for flight."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from visloc_companion.errors import ConfigError

if TYPE_CHECKING:
    from visloc_companion.train.run import Watcher

train_app = typer.Typer(help="Train feature networks and export them (needs the extra `train`).", no_args_is_help=True)
INTERRUPTED = 130
"""Exit code of a program that Ctrl-C ended."""
PLAIN_EVERY = 50
"""Steps between lines where stderr is no terminal."""


@train_app.command()
def features(
    config: Annotated[Path, typer.Option(metavar="FILE", help="Configuration of the training (TOML).")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the run; one that was broken off goes on.")],
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder that the sources' folders lie in; the configuration's by default.")
    ] = None,
    first: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="checkpoint.pt of another run whose weights to begin with.")
    ] = None,
    device: Annotated[str, typer.Option(help="cpu, cuda or cuda:N.")] = "cpu",
    workers: Annotated[
        int,
        typer.Option(min=0, help="Processes that make pairs where a GPU waits for them, at most one a core; 0: a thread."),
    ] = 0,
) -> None:
    """Train a network that makes dense features of map and frame."""
    from visloc_companion.train.extra import require_training

    require_training()
    from visloc_companion.train.config import load_training_config
    from visloc_companion.train.run import train

    settings = load_training_config(config)
    try:
        with _watcher() as watcher:
            checkpoint = train(settings, data or config.parent, out, watcher, device, first, workers)
    except KeyboardInterrupt:
        typer.echo(f"broken off; the same command goes on from the last checkpoint in {out}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(
        f"{checkpoint}: {settings.schedule.steps} steps; now: visloc train export --checkpoint {checkpoint} --name NAME --out DIR"
    )


@train_app.command()
def export(
    checkpoint: Annotated[Path, typer.Option(metavar="FILE", help="checkpoint.pt of a run.")],
    name: Annotated[str, typer.Option(help="Name of the model: letters, digits, hyphens.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, usually models/NAME.")],
    licence: Annotated[str, typer.Option(help="Licence of the weights.")] = "Apache-2.0",
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Data of the training: compares on its validation pairs too.")
    ] = None,
    cases: Annotated[Path | None, typer.Option(metavar="CASES", help="Image cases: states localisation figures too.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first so many cases.")] = None,
) -> None:
    """Write ONNX files, golden vector, manifest and model card; nothing where a file answers otherwise than PyTorch."""
    from visloc_companion.train.extra import require_training

    require_training()
    from visloc_companion.cli.progress import spinner
    from visloc_companion.localise.model_folder import NAME_PATTERN
    from visloc_companion.train.export import ExportOrder
    from visloc_companion.train.export import export as write_model

    if not re.fullmatch(NAME_PATTERN, name):
        raise ConfigError(
            f"{name!r} is no name",
            where="--name",
            remedy="use letters, digits, hyphens and underscores, the first a letter or digit",
        )
    with spinner("export") as tell:
        manifest = write_model(ExportOrder(checkpoint, name, out, licence, data, cases, limit), tell)
    for variant, entry in manifest.variants.items():
        typer.echo(f"{out / entry.file}: {variant}, {entry.bytes / 1000:.0f} kB")
    for figure, value in manifest.figures.items():
        typer.echo(f"{figure:72} {value}")


@contextmanager
def _watcher() -> Iterator[Watcher]:
    """A bar on a terminal, lines elsewhere; both on stderr with the time that is left."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines()
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, speed_estimate_period=300) as progress:
        task = progress.add_task("preparing", total=None)

        class Bar(_Lines):
            def preparing(self, what: str) -> None:
                progress.update(task, description=what)

            def stepped(self, step: int, steps: int, loss: float, seconds_per_step: float) -> None:
                progress.update(task, description=f"loss {loss:.3f}", completed=step, total=steps)

            def write(self, words: str) -> None:
                progress.console.print(words, highlight=False, markup=False)

        yield Bar()


class _Lines:
    """`visloc_companion.train.run.Watcher` as plain lines."""

    def preparing(self, what: str) -> None:
        """A source is being opened or made."""
        self.write(f"preparing {what}")

    def stepped(self, step: int, steps: int, loss: float, seconds_per_step: float) -> None:
        """A line now and then."""
        if step % PLAIN_EVERY == 0 or step == steps:
            self.write(f"step {step} of {steps}: loss {loss:.3f}, {duration((steps - step) * seconds_per_step)} left")

    def validated(self, step: int, wrong: Mapping[str, float], gradient_wrong: Mapping[str, float]) -> None:
        """A line for each validation."""
        each = [f"{name} {share:.1%} (gradient {gradient_wrong.get(name, float('nan')):.1%})" for name, share in wrong.items()]
        self.write(f"step {step}: placed wrong: {', '.join(each)}")

    def write(self, words: str) -> None:
        """One line on stderr."""
        sys.stderr.write(words + "\n")


def duration(seconds: float) -> str:
    """Hours and minutes, or seconds where there is less than a minute."""
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 1 else f"{seconds:.0f} s"
