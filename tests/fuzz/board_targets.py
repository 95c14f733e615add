"""Targets for board data: single files, whole ODB++ designs, archives, compressed members, options."""

from __future__ import annotations

import gzip
import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pydantic import ValidationError

from tests.board_data.readers.samples import KICAD
from vaoi_station.board_data import Options, read_design, to_board_type
from vaoi_station.board_data.design import Side
from vaoi_station.board_data.import_process import ImportTask, import_file
from vaoi_station.board_data.readers import unix_compress
from vaoi_station.board_data.readers.ipc_d356 import is_ipc_d356, read_ipc_d356
from vaoi_station.board_data.readers.kicad import read_kicad
from vaoi_station.errors import VaoiError

SIDES: tuple[Side, ...] = ("top", "bottom")
MEMBER = b"==== "
"""Begin of the line that names the member of a design whose content follows."""


def _both_sides(file: Path, step: str | None = None) -> None:
    """Make board types of both sides; raise the refusal if both are refused."""
    design, refusals = read_design(file, Options(step=step)), []
    for side in SIDES:
        try:
            to_board_type(design, side)
        except VaoiError as error:
            refusals.append(error)
    if len(refusals) == len(SIDES):
        raise refusals[0]


def board_data(data: bytes, folder: Path) -> None:
    """Read the bytes as board data of a CAD system: as they are, and as two files of an ODB++ design.

    These are the component layer of a board, and the header of a panel of such boards. A netlist is laid on a board.
    """
    path, job, panel = folder / "b.txt", folder / "job", folder / "panel"
    if is_ipc_d356(data):
        to_board_type(replace(read_kicad(KICAD.encode(), path), net_points=read_ipc_d356(data, path)), "top")
        return
    layer = Path("steps", "s", "layers", "comp_+_top", "components")
    members = {path: data, job / "matrix" / "matrix": b"", job / layer: data, panel / "matrix" / "matrix": b""}
    members |= {panel / layer: b"UNITS=MM\nCMP 0 1 1 0 N R1 10k;\n", panel / "steps" / "panel" / "stephdr": data}
    for name, content in members.items():
        name.parent.mkdir(parents=True, exist_ok=True)
        name.write_bytes(content)
    errors = []
    files: list[tuple[Path, str | None]] = [(path, None), (job, None)]
    files += [(file, "panel") for file, mark in ((path, b"<StepRepeat"), (panel, b"STEP-REPEAT")) if mark in data]
    for file, step in files:
        try:
            _both_sides(file, step)
        except VaoiError as error:
            errors.append(error)
    if len(errors) == len(files):
        raise errors[0]


def odb_design(data: bytes, folder: Path) -> None:
    """Read a design whose members the bytes list, each behind a line that names it; a name in `.gz` is compressed."""
    for part in data.split(b"\n" + MEMBER)[:40]:
        line, _, content = part.removeprefix(MEMBER).partition(b"\n")
        name = line.decode("latin-1").strip("/ ")
        with suppress(OSError, ValueError):  # names that no file can have, or that two members share
            member = (folder / name).resolve()
            if member.is_relative_to(folder.resolve()):
                member.parent.mkdir(parents=True, exist_ok=True)
                member.write_bytes(gzip.compress(content, 1) if name.endswith(".gz") else content)
    for step in (None, "panel"):
        _both_sides(folder, step)


def board_archive(data: bytes, folder: Path) -> None:
    """Read the bytes as an archive; what is neither compressed nor zip is the content of a tgz."""
    path = folder / "b"
    # A wrong checksum of gzip would hide all behind it, so that the tar file is compressed here.
    path.write_bytes(data if data[:2] in (b"\x1f\x8b", b"PK") else gzip.compress(data, 1))
    _both_sides(path)


def unix_compressed(data: bytes, folder: Path) -> None:
    """Decompress a member of Unix compress."""
    unix_compress.decompress(data, "b.Z", 10**6)


def import_options(data: bytes, folder: Path) -> None:
    """Import a file with options: a JSON object of a task, in which `file` and `join` are contents."""
    try:
        given = json.loads(data)
        for key in ("file", "join"):
            if isinstance(given.get(key), str):
                (folder / key).write_text(given[key], encoding="utf-8", errors="replace")
                given[key] = str(folder / key)
        given.pop("sizes", None)  # a path: tables are given as text
        task = ImportTask.model_validate(given)
    except (ValueError, TypeError, AttributeError, RecursionError, ValidationError):
        return
    import_file(task)
