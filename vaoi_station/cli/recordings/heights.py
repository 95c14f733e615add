"""`vaoi heights CASE --result result.json --out FILE`: measure the heights of components."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def heights(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    out: Annotated[Path, typer.Option(help="Write the heights to this file (JSON).")],
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
) -> None:
    """Measure how far every component stands above the board, from all frames that show it."""
    from vaoi_station.errors import InputError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
    from vaoi_station.files.documents import write_json
    from vaoi_station.heights.comparison import heights_document
    from vaoi_station.heights.estimates import measure_heights
    from vaoi_station.library.stitched_run import check_result
    from vaoi_station.stitching.recordings.origin import check_origin

    recording = open_recording(case)
    head = recording.head
    inputs = {calibration or case / "calibration.json", board or case / "board.json", case / "recording.json", result}
    if out.resolve() in {path.resolve() for path in inputs}:
        raise InputError(f"{out}: is read by this command and is not overwritten.", action="Give another --out.")
    known = read_calibration(calibration or case / "calibration.json", head.cameras)
    cameras = known.cameras(head.cameras)
    board_type = read_board_type(board or case / "board.json")
    stitch = read_stitch(result)
    check_result(stitch, head.rows, cameras, result)
    check_origin(stitch, recording, known, board_type, result)
    found = measure_heights(board_type, stitch, cameras, recording.frame, head.lights or ())
    write_json(out, heights_document(found, board_type))
    measured = sum(height.height_mm is not None for height in found.values())
    intervals = sum(height.low_mm is not None for height in found.values())
    typer.echo(f"{len(found)} component(s): {measured} height(s), {intervals} interval(s) → {out}")
