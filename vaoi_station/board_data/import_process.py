"""Import board data in a process of its own: `python -m vaoi_station.board_data.import_process`.

Files of unknown origin may be made to exhaust memory or time. The process reads limits and task from standard input,
writes its reply to standard output, and can do no harm beyond its limits.
"""

from __future__ import annotations

import logging
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

from pydantic import Field

from vaoi_station.board_data.conversion import to_board_type
from vaoi_station.board_data.design import Side
from vaoi_station.board_data.overview import ImportOverview, overview
from vaoi_station.board_data.package_sizes import parse_table, read_table
from vaoi_station.board_data.panels import Grid
from vaoi_station.board_data.picture import board_picture
from vaoi_station.board_data.readers.placement_table import TableOptions
from vaoi_station.board_data.reading import Options, read_design
from vaoi_station.child_environment import child_environment
from vaoi_station.errors import InputError, VaoiError
from vaoi_station.model import Strict
from vaoi_station.model.board_type import STORED_NAME, STORED_NAME_RULE

_log = logging.getLogger(__name__)

NICE = 10
"""Priority below that of the station, whose workers stitch meanwhile."""


class ImportTask(Strict):
    """A file to import, with what the user says about it."""

    file: Path
    side: Side = "top"
    name: str | None = None
    format: str | None = None
    units: str | None = None
    columns: str | None = None
    delimiter: str | None = None
    step: str | None = None
    repeat: str | None = None
    pitch: str | None = None
    rotate: str | None = None
    border: str | None = None
    sizes: Path | None = None
    """File with a table of body sizes."""
    size_table: str | None = None
    """The text of such a table."""
    join: Path | None = None
    """File with the bodies."""
    test_points: bool = True
    """Whether pads and vias of the file become test points."""


class ImportReply(Strict):
    """The board type of one side, with what was found, or the refusal."""

    overview: ImportOverview | None = None
    board_type: str = ""
    """The document board.json."""
    picture: str = ""
    """SVG."""
    refusal: str = ""
    action: str = ""


class ImportLimits(Strict):
    """What an import may use."""

    memory_bytes: int = Field(default=1536 * 2**20, description="Address space of the process.")
    cpu_s: int = 60
    wall_s: float = 120.0
    most_reply: int = Field(default=32 * 2**20, description="Characters of the reply, which the station keeps.")
    advice: str = Field(
        default="Export it with fewer layers, or import it by `vaoi import`, whose limits are larger.",
        description="What to do about a file that exceeds a limit.",
    )


OF_PERSONS = ImportLimits(
    memory_bytes=8 * 2**30,
    cpu_s=900,
    wall_s=1800.0,
    most_reply=512 * 2**20,
    advice="Export it with fewer layers, or the board without its panel.",
)
"""Limits of an import on the command line or in a program: a person waits, and may end it."""


def import_limited(task: ImportTask, limits: ImportLimits | None = None) -> ImportReply:
    """Import a file in a process of its own; raise InputError if it is refused, or exceeds a limit."""
    limits = limits or ImportLimits()
    # One thread of BLAS: each reserves address space, of which the process has little.
    environment = child_environment(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    command = [sys.executable, "-P", "-m", "vaoi_station.board_data.import_process"]
    text = f"{limits.model_dump_json()}\n{task.model_dump_json()}\n"
    try:
        done = subprocess.run(
            command, input=text, capture_output=True, text=True, env=environment, timeout=limits.wall_s, check=False
        )
    except subprocess.TimeoutExpired:
        refusal = f"{task.file}: cannot be read within {limits.wall_s:g} s; the file is refused."
        raise InputError(refusal, action=limits.advice) from None
    if done.returncode != 0 or done.stderr:
        _log.info("import of %s ended with code %d: %s", task.file, done.returncode, done.stderr[-2000:])
    if done.returncode != 0:
        raise InputError(
            f"{task.file}: cannot be read within {limits.cpu_s} s of computing time and {limits.memory_bytes >> 20} MB "
            "of memory; the file is refused.",
            action=limits.advice,
        )
    reply = ImportReply.model_validate_json(done.stdout)
    if reply.refusal:
        raise InputError(reply.refusal, action=reply.action)
    return reply


def import_file(task: ImportTask) -> ImportReply:
    """Import a file; raise VaoiError if the file or an option is refused."""
    if task.name is not None and not re.fullmatch(STORED_NAME, task.name):
        raise InputError.field("--name", "the name", task.name, STORED_NAME_RULE)
    table = TableOptions.parse(task.units, task.columns, task.delimiter)
    grid = Grid.parse(task.repeat, task.pitch, task.rotate, task.border)
    sizes = read_table(task.sizes) if task.sizes is not None else ()
    if task.size_table is not None:
        sizes = parse_table(task.size_table, "sizes")
    design = read_design(
        task.file, Options(task.format, table, task.step, sizes, grid, task.test_points), task.join, task.side
    )
    board, notes = to_board_type(design, task.side, task.name)
    document = board.model_dump_json(exclude_none=True)
    return ImportReply(overview=overview(design, board, notes), board_type=document, picture=board_picture(board))


def run_import(task: ImportTask) -> ImportReply:
    """Import a file; a refusal is part of the reply."""
    try:
        return import_file(task)
    except VaoiError as error:
        return ImportReply(refusal=error.message, action=error.action)
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001  readers cannot foresee all damage
        # No warning: the caller has the refusal, and on a command line a warning would be printed beside it.
        _log.info("import of %s", task.file, exc_info=True)
        return ImportReply(
            refusal=f"{task.file}: is damaged, or not as its format demands ({type(error).__name__}).",
            action="Export it again. If that does not help, report it with the file to the makers of the station.",
        )


def reply_text(task: ImportTask, limits: ImportLimits) -> str:
    """Import a file, and return the reply as JSON; one that is too long, or needs too much memory, is a refusal."""
    try:
        text = run_import(task).model_dump_json(exclude_none=True)
    except MemoryError:
        refusal = f"{task.file}: needs more than {limits.memory_bytes >> 20} MB of memory; the file is refused."
    else:
        if len(text) <= limits.most_reply:
            return text
        refusal = (
            f"{task.file}: makes a board type with picture and overview of {len(text) / 1e6:.1f} million characters, "
            f"the limit is {limits.most_reply / 1e6:.1f} million; the file is refused."
        )
    return ImportReply(refusal=refusal, action=limits.advice).model_dump_json(exclude_none=True)


def main() -> None:
    """Read limits and task, one line each, apply the limits, import, write the reply."""
    limits = ImportLimits.model_validate_json(sys.stdin.readline())
    task = ImportTask.model_validate_json(sys.stdin.readline())
    resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    os.nice(NICE)
    sys.stdout.write(reply_text(task, limits))


if __name__ == "__main__":
    main()
