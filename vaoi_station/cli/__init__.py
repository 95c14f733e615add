"""The command line `vaoi`.

Heavy imports are inside the commands, so that `--help` is fast.
"""

from __future__ import annotations

import errno
import logging
import os
import sys
from typing import Annotated, NoReturn

import typer

from vaoi_station.cli.archive import app as archive
from vaoi_station.cli.bench import bench
from vaoi_station.cli.board_types import board_types
from vaoi_station.cli.calibrating import calibrate, calibration_board, flatfield, recalibrate
from vaoi_station.cli.cameras import cameras
from vaoi_station.cli.cutting import cut
from vaoi_station.cli.demo import demo
from vaoi_station.cli.keys import keys
from vaoi_station.cli.line import app as line
from vaoi_station.cli.parts import parts
from vaoi_station.cli.plan import plan
from vaoi_station.cli.plants import dataset, restitch
from vaoi_station.cli.recorded import check_board, heights, identify, mosaic, report, simulate, stitch, teach
from vaoi_station.cli.rig import rig
from vaoi_station.cli.stations import (
    backup,
    bundle,
    check_config,
    doctor,
    export,
    import_file,
    record,
    restore,
    serve,
)
from vaoi_station.errors import InputError, InternalError, NotFoundError, VaoiError
from vaoi_station.version import __version__

# Our matrices are small: threads of the linear algebra library cost more than they save, and would take
# the cores that cameras and workers need. Child processes inherit this; it must be set before numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_PASSING = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.ESTALE}
)
"""Errors that may pass without a change of the input.

They must not end the program with code 2, because systemd does not restart a service that ends with code 2."""

# Rich tracebacks are off, because `main` prints errors itself, in one sentence.
app = typer.Typer(
    name="vaoi",
    help="Inline Video-AOI station: plan it, simulate it, film boards, stitch them, cut component images.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # With markup on, Rich takes [defaults] in help texts for style tags and drops them.
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"vaoi_station {__version__}")
        raise typer.Exit


@app.callback()
def vaoi(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Process the options of `vaoi` itself, such as `--version`. All other calls have the form `vaoi COMMAND`."""


for _command in (
    plan, simulate, serve, bundle, check_config, record, calibrate, calibration_board, recalibrate, flatfield, stitch,
    report, teach, cut, mosaic, heights, parts, identify, check_board, restitch, dataset, bench, demo, doctor, backup,
    restore, export,
):  # fmt: skip
    app.command(_command.__name__.replace("_", "-"))(_command)
app.command("import")(import_file)
app.add_typer(rig, name="rig")
app.add_typer(keys, name="keys")
app.add_typer(archive, name="archive")
app.add_typer(board_types, name="board-types")
app.add_typer(cameras, name="cameras")
app.add_typer(line, name="line")


def main() -> None:
    """Run a command. Print errors as one sentence on stderr. Exit code: 2 (input), 3 (device, state), 4 (internal)."""
    try:
        app()
    except VaoiError as error:
        _end(
            str(error),
            2 if isinstance(error, InputError | NotFoundError) else 4 if isinstance(error, InternalError) else 3,
        )
    except OSError as error:
        # No lower layer has described this error of a file or device. Its path is the best information available.
        _end(f"{error.filename or 'the system'}: {error.strerror or error}.", 3 if error.errno in _PASSING else 2)
    except Exception as error:  # any other exception is an internal error; the user still gets one sentence
        if os.environ.get("VAOI_TRACEBACK"):
            raise
        kind = type(error).__name__
        _end(f"internal error: {kind}: {error}. Report it with the traceback that VAOI_TRACEBACK=1 shows.", 4)


def _end(message: str, code: int) -> NoReturn:
    from vaoi_station.runs.host.logs import is_journal, with_priority

    text = f"vaoi: {message}"
    # `journalctl -p warning` shows why a service has ended: without a priority the journal counts it as information.
    sys.stderr.write((with_priority(text, logging.ERROR) if is_journal(os.environ, 2) else text) + "\n")
    sys.exit(code)
