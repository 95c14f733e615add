"""`vaoi heights CASE --result result.json --out FILE`: measure the heights of components."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from numpy.typing import NDArray


def heights(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    out: Annotated[Path, typer.Option(help="Write the heights to this file (JSON).")],
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
    flatfield: Annotated[
        Path | None, typer.Option(help="Use the flat fields that `vaoi flatfield` wrote to this directory.")
    ] = None,
    map: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            help="Write also a map of heights of the region X0 Y0 X1 Y1 in CAD coordinates, beside FILE: .map.tiff, "
            ".map-sigma.tiff, .map.png, .map.json."
        ),
    ] = None,
) -> None:
    """Measure how far every component stands above the board, from all frames that show it."""
    from vaoi_station.errors import InputError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.heights.comparison import heights_document
    from vaoi_station.heights.equalised_frames import equalised_frames
    from vaoi_station.heights.estimates import measure_heights, open_places
    from vaoi_station.heights.height_map import draw_map, measure_map
    from vaoi_station.library.recordings import check_result
    from vaoi_station.photometry import FlatFields
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
    frame: Callable[[int, int], NDArray[Any] | None] = recording.frame
    lights = head.lights or ()
    if flatfield is not None:
        fields = FlatFields.open(flatfield)
        fields.check_head(head)
        frame = equalised_frames(frame, fields, lights)
    # A region that is refused leaves no file.
    region = None if map is None else measure_map(open_places(board_type, stitch, cameras), map, frame, lights)
    found = measure_heights(board_type, stitch, cameras, frame, lights)
    write_json(out, heights_document(found, board_type))
    measured = sum(height.height_mm is not None for height in found.values())
    intervals = sum(bool(height.intervals) for height in found.values())
    typer.echo(f"{len(found)} component(s): {measured} height(s), {intervals} interval(s) → {out}")
    if region is not None:
        write_image(out.with_suffix(".map.tiff"), region.height_mm)
        write_image(out.with_suffix(".map-sigma.tiff"), region.sigma_mm)
        write_image(out.with_suffix(".map.png"), draw_map(region))
        head_of_map = {"image_from_cad": region.image_from_cad.tolist(), "px_per_mm": region.px_per_mm}
        write_json(out.with_suffix(".map.json"), head_of_map)
        h, w = region.height_mm.shape
        typer.echo(f"map of {w} × {h} places → {out.with_suffix('.map.tiff')}")
