"""Name files that are no board data by their first bytes, so that a refusal can say what they are and what to do."""

from __future__ import annotations

import re
from pathlib import Path

from vaoi_station.board_data.design import some
from vaoi_station.board_data.source_text import Archive
from vaoi_station.errors import InputError

_BOARD = "Give the board: KiCad's is the .kicad_pcb."
_LAYERS = "It has no bodies of components. Export ODB++, IPC-2581 or GenCAD, or a centroid file."
_NETLIST = "It has no bodies of components. Join it with the file of the board, to which it adds test points (--join)."
_DATA = "Export the data themselves: ODB++, IPC-2581, GenCAD, a board of KiCad or EAGLE, or a centroid file."
_UNPACK = "Unpack it, and give the file with board data, or a zip of the ODB++ folder."
# No pattern repeats what could be matched in several ways: its time would grow beyond all limits.
_KINDS: tuple[tuple[re.Pattern[bytes], str, str], ...] = tuple(
    (re.compile(pattern), what, action)
    for pattern, what, action in (
        (rb"\(kicad_sch\b", "a schematic of KiCad", _BOARD),
        (rb"EESchema", "a schematic of KiCad 5", _BOARD),
        (rb"\((kicad_symbol_lib|footprint|module|kicad_wks)\b", "a library file of KiCad", _BOARD),
        (rb"(G04[^\n]*\*|G75\*|G36\*|%FS|%MO|%TF)", "a Gerber file", _LAYERS),
        (rb"M48\s*\n", "a drill file", _LAYERS),
        (rb"(C  [^\n]*\n)*P  (JOB|UNITS|CODE|TITLE)\b", "an IPC-D-356 netlist", _NETLIST),
        (rb"%PDF", "a PDF", _DATA),
        (rb"\x89PNG|\xff\xd8\xff|GIF8|II\*\0|MM\0\*", "a picture", _DATA),
        (rb"ISO-10303-21;", "a 3-D model (STEP)", _DATA),
        (rb"0\s+SECTION\s", "a drawing (DXF)", _DATA),
        (rb"(?i)<!doctype html|<html", "a page without data of InteractiveHtmlBom", _DATA),
        (rb"<\?xml\b|<[A-Za-z]", "an XML file of another kind", _DATA),
        (rb"Rar!", "a RAR archive", _UNPACK),
        (rb"7z\xbc\xaf", "a 7-Zip archive", _UNPACK),
        (rb"\x28\xb5\x2f\xfd", "a file compressed by zstd", _UNPACK),
        (rb"\xd0\xcf\x11\xe0", "a binary file of Altium or Excel", "Export ODB++, or save the table as CSV."),
        (rb"\x10[\x00\x80]", "a binary file of EAGLE 5 or older", "Open and save the board with EAGLE 6 or later."),
    )
)
_BY_NAME = {".kicad_pcb": "board of KiCad", ".brd": "board of EAGLE", ".gencad": "GenCAD file", ".cvg": "IPC-2581 file"}
"""What files are by their names, which no centroid file has."""


def refuse_foreign(path: Path, head: bytes) -> None:
    """Raise InputError if a file is of a known kind that is no board data, or its name promises another format."""
    head = head.removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")
    found = next(((what, action) for pattern, what, action in _KINDS if pattern.match(head)), None)
    if found is not None:
        raise InputError(f"{path}: is {found[0]}, not board data.", action=found[1])
    if (promised := _BY_NAME.get(path.suffix.lower())) is not None:
        beginning = head[:40].decode("utf-8", "replace").partition("\n")[0].rstrip()
        raise InputError(
            f"{path}: is no {promised}, as its name says; it begins with {beginning!r}.",
            action="Export it again. If it is a centroid file, state --format centroid.",
        )


def refuse_archive(archive: Archive) -> None:
    """Raise InputError for an archive that holds no ODB++ design, with what it holds."""
    path, names = archive.where, list(archive.members)
    if any(name.startswith("xl/") for name in names):
        raise InputError(f"{path}: is a workbook of Excel, not board data.", action="Save the table as CSV.")
    raise InputError(
        f"{path}: is an archive without matrix/matrix, so no ODB++ design; it holds {some(names, 3) or 'no file'}.",
        action="Unpack it, and give the file with board data.",
    )
