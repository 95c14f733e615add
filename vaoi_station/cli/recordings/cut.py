"""`vaoi cut CASE --result result.json --component U1 --out DIR`: write the temporary images of components."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def cut(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    component: Annotated[
        list[str], typer.Option(help="Cut this component (reference designator); repeat the option for several.")
    ],
    out: Annotated[Path, typer.Option(help="Write the images to this directory.")],
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
    px_per_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="Resolution of the images [that of the cameras].")
    ] = None,
    min_coverage: Annotated[
        float, typer.Option(min=0, max=1, help="Skip frames that show a smaller share of it.")
    ] = 0.5,
) -> None:
    """Cut upright, CAD-aligned images of components from every frame that shows them."""
    from vaoi_station.errors import NotFoundError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.library.stitched_run import check_result
    from vaoi_station.rendering import compute_views, render
    from vaoi_station.stitching.recordings.origin import check_origin

    recording = open_recording(case)
    head = recording.head
    known = read_calibration(calibration or case / "calibration.json", head.cameras)
    cameras = known.cameras(head.cameras)
    board_type = read_board_type(board or case / "board.json")
    stitch = read_stitch(result)
    check_result(stitch, head.rows, cameras, result)
    check_origin(stitch, recording, known, board_type, result)
    for address in component:
        part = board_type.component(address)
        if part is None:
            raise NotFoundError(
                f"board type {board_type.name!r} has no component {address!r}.",
                action=f"It has {', '.join(c.address for c in board_type.components[:8])} …",
            )
        views = compute_views(part, board_type, stitch, cameras, px_per_mm=px_per_mm, min_coverage=min_coverage)
        listing = []
        for k, view in enumerate(views):
            # The result may place a frame that is missing: the other frames of its row determine its matrix.
            frame = recording.frame(view.camera, view.row)
            if frame is None:
                continue
            # On a panel the address is panel/ref. In a file name the slash would create a directory.
            stem = address.replace("/", "_")
            name = f"{stem}_{k:02d}_c{view.camera:02d}_r{view.row:03d}.png"
            write_image(out / name, render(view, frame))
            listing.append(
                {
                    "file": name,
                    "camera": view.camera,
                    "row": view.row,
                    "coverage": round(view.coverage, 4),
                    "px_per_mm": view.px_per_mm,
                    "crop_from_cad": view.crop_from_cad.matrix.tolist(),
                    "cad_from_crop": view.cad_from_crop.matrix.tolist(),
                    "image_from_crop": view.image_from_crop.matrix.tolist(),
                    "image_from_crop_is": "undistorted pixels" if view.distorted else "raw pixels",
                }
            )
        write_json(out / f"{address.replace('/', '_')}.json", listing)
        typer.echo(f"{address}: {len(listing)} image(s) → {out}")
