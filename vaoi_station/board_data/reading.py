"""Recognise the format of a file with board data and read it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from vaoi_station.board_data import package_sizes
from vaoi_station.board_data.design import Design, Side
from vaoi_station.board_data.foreign_files import refuse_archive, refuse_foreign
from vaoi_station.board_data.frame import without_frame
from vaoi_station.board_data.joining import join_designs
from vaoi_station.board_data.net_points import NOTES, with_net_points
from vaoi_station.board_data.panels import Grid, laid_out, repeated, with_copies
from vaoi_station.board_data.readers.eagle import is_eagle, read_eagle
from vaoi_station.board_data.readers.gencad import is_gencad, read_gencad
from vaoi_station.board_data.readers.html_bom import is_html_bom, read_html_bom
from vaoi_station.board_data.readers.ipc2581 import is_ipc2581, read_ipc2581
from vaoi_station.board_data.readers.ipc_d356 import is_ipc_d356, read_ipc_d356
from vaoi_station.board_data.readers.kicad import is_kicad, read_kicad
from vaoi_station.board_data.readers.odb import is_odb, read_odb
from vaoi_station.board_data.readers.placement_table import TableOptions, read_placement_table
from vaoi_station.board_data.source_text import head_of, open_archive, read_bytes
from vaoi_station.errors import InputError

FORMATS = ("kicad", "gencad", "ipc2581", "odb", "eagle", "html-bom", "centroid")
_WITH_STEPS = frozenset({"odb", "ipc2581"})


@dataclass(frozen=True)
class Options:
    """What the user says about a file; None: recognise it."""

    format: str | None = None
    table: TableOptions = field(default_factory=TableOptions)
    step: str | None = None
    """Step of an ODB++ design or an IPC-2581 file: a board, or a panel that repeats it."""
    sizes: package_sizes.Table = ()
    """Body sizes that come before the shipped table."""
    grid: Grid | None = None
    """How the board is repeated on a panel of which the file has no data."""
    test_points: bool = True
    """Whether pads and vias of the file become test points."""


_READERS: dict[str, tuple[Callable[[bytes], bool], Callable[[bytes, Path, Options], Design]]] = {
    "kicad": (is_kicad, lambda data, path, _: read_kicad(data, path)),
    "gencad": (is_gencad, lambda data, path, _: read_gencad(data, path)),
    "ipc2581": (is_ipc2581, lambda data, path, options: read_ipc2581(data, path, options.step)),
    "eagle": (is_eagle, lambda data, path, _: read_eagle(data, path)),
    "html-bom": (is_html_bom, lambda data, path, _: read_html_bom(data, path)),
    "centroid": (lambda _: False, lambda data, path, options: read_placement_table(data, path, options.table)),
}
"""How a format is recognised by the beginning of a file, and read. What none recognises is a centroid file."""


def is_exported_run(path: Path) -> bool:
    """Return whether a file may be a run that `vaoi export` has written: a compressed tar file, but no ODB++ design."""
    return path.is_file() and _head(path)[:2] == b"\x1f\x8b" and not is_odb(path)


def read_design(path: Path, options: Options | None = None, join: Path | None = None, side: Side = "top") -> Design:
    """Read a file or folder with board data; bodies that it does not state get sizes from a table.

    Args:
        path: the file or folder.
        options: what the user says about it.
        join: a second file, with the bodies of the parts, or the netlist of the board (IPC-D-356).
        side: the side for which both files are joined.

    Returns:
        The design; of a panel with the parts and marks of all boards.

    Raises:
        InputError: a file cannot be understood, exceeds a limit, or both do not fit each other.
    """
    options = options or Options()
    if options.format is not None and options.format not in FORMATS:
        raise InputError.field("--format", "the format", options.format, f"one of {', '.join(FORMATS)}")
    sizes = (*options.sizes, *package_sizes.shipped_table())
    design = _completed(_read(path, options), sizes)
    netlist = join if join is not None and join.is_file() and is_ipc_d356(_head(join)) else None
    second = join if netlist is None else None
    bodies = _completed(_read(second, Options(step=options.step)), sizes) if second is not None else None
    _refuse_without_effect(path, options, design.format, bodies.format if bodies is not None else None)
    if bodies is not None:
        design = join_designs(design, bodies, side)
    if netlist is not None:
        design = with_net_points(design, read_ipc_d356(read_bytes(netlist), netlist), side)
    if netlist is not None or not options.test_points:
        design = replace(design, notes=tuple(note for note in design.notes if note.code not in NOTES))
    laid = laid_out(repeated(design, options.grid) if options.grid is not None else design)
    return laid if options.test_points else replace(laid, net_points=())


def _completed(design: Design, sizes: package_sizes.Table) -> Design:
    return without_frame(with_copies(package_sizes.with_sizes(design, sizes)))


def _read(path: Path, options: Options) -> Design:
    head = b"" if path.is_dir() else _head(path)
    packed = head[:2] in (b"PK", b"\x1f\x8b", b"BZ") or head[:6] == b"\xfd7zXZ\x00" or head[257:262] == b"ustar"
    may_be_archive = options.format is None and (packed or path.is_dir())
    if options.format == "odb" or (may_be_archive and is_odb(path)):
        return read_odb(path, options.step)
    if path.is_dir():
        raise InputError(f"{path}: is a folder without matrix/matrix. Of folders, only ODB++ designs can be read.")
    if may_be_archive:
        with open_archive(path) as archive:
            refuse_archive(archive)
    data = read_bytes(path)
    if not data.strip():
        raise InputError(f"{path}: is empty.", action="Export it again.")
    head = head_of(data)
    chosen = options.format or next((name for name, (is_it, _) in _READERS.items() if is_it(head)), None)
    if chosen is None:
        refuse_foreign(path, head)
    _, read = _READERS[chosen or "centroid"]
    return read(data, path, options)


def _refuse_without_effect(path: Path, options: Options, found: str, joined: str | None) -> None:
    """Raise InputError if an option is given that files of the format found do not take."""
    table, columns = options.table, ",".join(f"{name}={at}" for name, at in options.table.columns)
    for key, value in (("units", table.unit), ("columns", columns), ("delimiter", table.delimiter)):
        if value and found != "centroid":
            raise InputError.field(path, f"--{key}", value, f"absent: it is for centroid files, not {found}")
    if options.step is not None and _WITH_STEPS.isdisjoint((found, joined)):
        limit = f"absent: it is for ODB++ and IPC-2581, not {found}"
        raise InputError.field(path, "--step", options.step, limit)


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(512)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from error
