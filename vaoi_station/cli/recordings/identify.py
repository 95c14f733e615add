"""`vaoi identify CASE --result result.json`: read the codes of a board, and compare its id."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def identify(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    expect: Annotated[str | None, typer.Option(help="Compare the id that is read with this one.")] = None,
    out: Annotated[Path | None, typer.Option(help="Also write ids and codes to this file (JSON).")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
) -> None:
    """Read the DataMatrix and QR codes of a board: at the places that its type states, or anywhere."""
    from vaoi_station.cli.recordings.cut_hdr import Case
    from vaoi_station.errors import InputError
    from vaoi_station.files.documents import write_json
    from vaoi_station.identity.code_reader import read_codes
    from vaoi_station.identity.comparison import compare
    from vaoi_station.model import BoardIdentity

    inputs = {calibration or case / "calibration.json", board or case / "board.json", case / "recording.json", result}
    if out is not None and out.resolve() in {path.resolve() for path in inputs}:
        raise InputError(f"{out}: is read by this command and is not overwritten.", action="Give another --out.")
    opened = Case.open(case, result, calibration, board)
    reading = read_codes(opened.board_type, opened.stitch, opened.cameras, opened.recording.frame)
    # Without `identity` in the board type, any code is taken for the board's.
    identity = opened.board_type.identity or BoardIdentity()
    found = compare(identity, reading, expect, skipped=opened.stitch.skipped_boards or ())
    mm = opened.board_type.unit
    for code in found.codes:
        x, y = code.center
        of = "" if code.panel is None else f" of position {code.panel}"
        typer.echo(
            f"{code.symbology}{of} {code.text!r} at ({x:.2f}, {y:.2f}) {mm}: modules of {code.module_mm:.3f} mm, "
            f"{100 * code.error_correction_used:.0f} % of the error correction used"
        )
    for reason in found.reasons:
        typer.echo(f"{reason.code}: {reason.message}")
    typer.echo(f"identity: {found.state}" + (f", board {found.board_id!r}" if found.board_id is not None else ""))
    if out is not None:
        write_json(out, found.model_dump(mode="json", exclude_none=True))
