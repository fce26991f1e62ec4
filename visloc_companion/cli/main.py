"""Entry point of the `visloc` command: subcommands and exit codes (0 ok, 1 gate failed, 2 usage, 3 data, 4 link)."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from itertools import pairwise

import typer

from visloc_companion import __version__
from visloc_companion.cli.calibrate import calibrate
from visloc_companion.cli.demo import demo
from visloc_companion.cli.doctor import doctor
from visloc_companion.cli.evaluate import evaluate_app
from visloc_companion.cli.exit_code import exit_code
from visloc_companion.cli.here import here
from visloc_companion.cli.link_key import link_key
from visloc_companion.cli.map import map_app
from visloc_companion.cli.replay import replay
from visloc_companion.cli.run import run
from visloc_companion.cli.sim import sim
from visloc_companion.cli.streams import open_streams, standard_output
from visloc_companion.cli.train import train_app
from visloc_companion.cli.web import web
from visloc_companion.errors import CameraError, ConfigError, VislocError

app = typer.Typer(
    name="visloc",
    help="Keeps a drone knowing where it is without satellite navigation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(run)
app.command()(replay)
app.command()(sim)
app.command()(demo)
app.command()(web)
app.command()(doctor)
app.command()(calibrate)
app.command(context_settings={"ignore_unknown_options": True})(here)  # south of the equator its place begins with a minus
app.command()(link_key)
app.add_typer(map_app, name="map")
app.add_typer(evaluate_app, name="evaluate")
app.add_typer(train_app, name="train")


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"visloc-companion {__version__}")
        raise typer.Exit


@app.callback()
def _root(version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version.")) -> None:
    """Options before the subcommand."""


_OF_THE_PATH = (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ELOOP)
"""A file that this user may not look at, or that cannot be: nothing of the program."""


def require_nothing_empty(arguments: Sequence[str]) -> None:
    """Raises ConfigError where an argument is empty: of `--report "$UNSET"` and `--gate "$UNSET"` none says what was meant.

    An empty path is the current folder, and an empty gate one that nothing can fail.
    """
    for before, argument in pairwise(["visloc", *arguments]):
        option = argument.startswith("--") and argument.endswith("=")
        if option or not argument:
            name = argument[:-1] if option else f"what follows {before}"
            remedy = "give it a value (is a variable not set?), or leave it out"
            raise ConfigError("is empty", where=name, remedy=remedy)


def main() -> None:
    """Run the command line; errors of this package, and of paths, become one clear line and an exit code."""
    open_streams()
    with standard_output():
        try:
            require_nothing_empty(sys.argv[1:])
            app()
        except VislocError as error:
            kind = "camera error" if isinstance(error, CameraError) else "error"
            sys.stderr.write(f"{kind}: {error}\n")
            sys.exit(exit_code(error))
        except OSError as error:
            if error.filename is None or error.errno not in _OF_THE_PATH:
                raise
            remedy = "check the name, and that this user may use it and the folders above it"
            sys.stderr.write(f"error: {error.filename}: cannot be used: {error.strerror}; remedy: {remedy}\n")
            sys.exit(3)


if __name__ == "__main__":
    main()
