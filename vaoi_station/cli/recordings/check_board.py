"""`vaoi check-board CASE --result result.json --board-type board.json`: lay a board type over a stitched run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vaoi_station.board_check.report import BoardCheck


def check_board(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    board_type: Annotated[Path, typer.Option(help="Check this board type, for example one of `vaoi import`.")],
    out: Annotated[Path | None, typer.Option(help="Write the report to this file (JSON).")] = None,
    corrected: Annotated[Path | None, typer.Option(help="Write the corrected board type to this file.")] = None,
    revision: Annotated[
        str | None, typer.Option(help="Revision of the corrected board type [that of the data, with 'corrected'].")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Write a picture of the bodies laid over the board to this file (.png, .jpg).")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[
        Path | None, typer.Option(help="The board type with which the run was stitched [CASE/board.json].")
    ] = None,
) -> None:
    """Lay a board type over a stitched run: shift, rotation, mirror, scale of its components, and the correction."""
    from vaoi_station.errors import StateError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.files.pyramids import refuse_existing
    from vaoi_station.library.recordings import StitchedRun, check_result
    from vaoi_station.model import BoardType
    from vaoi_station.stitching.recordings.origin import check_origin

    for path in (out, corrected, picture):
        if path is not None:
            refuse_existing(path)
    recording = open_recording(case)
    known = read_calibration(calibration or case / "calibration.json", recording.head.cameras)
    cameras = known.cameras(recording.head.cameras)
    own_file = board or case / "board.json"
    own = read_board_type(own_file) if board is not None or own_file.is_file() else None
    stitch = read_stitch(result)
    check_result(stitch, recording.head.rows, cameras, result)
    check_origin(stitch, recording, known, own, result)
    checked = StitchedRun(recording, cameras, own, stitch).check_board_type(read_board_type(board_type))
    for line in _lines(checked.report):
        typer.echo(line)
    if out is not None:
        write_json(out, checked.report.model_dump(mode="json", exclude_none=True))
    if picture is not None:
        write_image(picture, checked.picture)
    if corrected is None:
        return
    if checked.corrected is None:
        raise StateError(
            f"{corrected}: is not written, because there is nothing to correct.", code="nothing-to-correct"
        )
    document = checked.corrected.model_dump(mode="json", exclude_none=True)
    document |= {} if revision is None else {"revision": revision}
    write_json(corrected, BoardType.model_validate(document).model_dump(mode="json", exclude_none=True))
    typer.echo(f"corrected ({', '.join(checked.report.moved)} moved) → {corrected}")


def _lines(report: BoardCheck) -> list[str]:
    """Return the report in sentences."""
    lines = []
    r = report.residual
    if r is not None:
        (x, y), (sx, sy) = r.shift_mm, r.shift_sigma_mm
        mirrored = ", mirrored" if r.mirrored else ""
        lines.append(
            f"{report.board_type}: shift ({x:.3f} ± {sx:.3f}, {y:.3f} ± {sy:.3f}) mm, rotation {r.rotation_deg:.3f} ± "
            f"{r.rotation_sigma_deg:.3f}°, scale {r.scale:.5f} ± {r.scale_sigma:.5f}{mirrored}"
        )
    lines += [f"check: {warning.message}" for warning in report.warnings]
    if not report.warnings:
        lines.append("nothing to correct")
    return lines
