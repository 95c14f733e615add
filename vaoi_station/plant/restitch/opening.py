"""Opens a run out of an archive as its station stitched it, except for what the terms state otherwise."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.documents import write_bytes
from vaoi_station.plant.archive.addition import REFERENCE
from vaoi_station.plant.archive.station_record import read_record
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.stitching.matching.evidence import METHODS
from vaoi_station.stitching.recordings.opening import OpenedRun, open_run
from vaoi_station.stitching.recordings.references import RESULT


def open_archived(folder: Path, scratch: Path, terms: Terms) -> tuple[OpenedRun, list[str]]:
    """Open an extracted run for stitching.

    Returns:
        The run, and in sentences why its result may differ from that of its station with equal terms.

    Raises:
        InputError: the documents do not fit together, or the method needs a reference that is absent or unusable.
    """
    reference = folder / REFERENCE
    calibration = _replaced("calibration.json", terms.calibration, scratch, reference)
    board = _replaced("board.json", terms.board_type, scratch, reference)
    record = read_record(folder)
    made = record.made_with if record else None
    method = terms.method or (made.method if made else "auto")
    notes: list[str] = []
    if record is not None and (made is None or made.terms is None):
        notes.append("Its station did not state where it expected the board, and what of it was to be seen.")

    def opened(placed_against: Path | None) -> OpenedRun:
        stated = made.terms if made else None
        return open_run(
            folder, calibration=calibration, board=board, reference=placed_against, method=method, terms=stated
        )

    if made is None or made.reference is None or not METHODS[method].reference:
        return opened(None), notes
    absent = f"The reference {made.reference}, against which its station placed the board,"
    if not reference.is_dir():
        return opened(None), [*notes, f"{absent} is not in the archive."]
    try:
        return opened(reference), notes
    except InputError as error:
        if method == "reference":
            raise
        # As the station does with a reference that has become unusable.
        return opened(None), [*notes, f"{absent} is not used: {error}"]


def _replaced(name: str, content: bytes | None, scratch: Path, reference: Path) -> Path | None:
    """Write another document as a file, and let it hold for the reference too, whose result is then out of date."""
    if content is None:
        return None
    write_bytes(scratch / name, content, durable=False)
    if reference.is_dir():
        write_bytes(reference / name, content, durable=False)
        (reference / RESULT).unlink(missing_ok=True)
    return scratch / name
