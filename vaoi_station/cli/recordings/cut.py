"""`vaoi cut CASE --result result.json --component U1 --out DIR`: temporary images of one component."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def cut(
    case: Annotated[Path, typer.Argument(help="Directory of the recording.")],
    result: Annotated[Path, typer.Option(help="Result of `vaoi stitch`.")],
    component: Annotated[list[str], typer.Option(help="Reference designator; may be given several times.")],
    out: Annotated[Path, typer.Option(help="Directory for the pictures.")],
    calibration: Annotated[Path | None, typer.Option(help="By default the recording's own.")] = None,
    board: Annotated[Path | None, typer.Option(help="By default the recording's own.")] = None,
    px_per_mm: Annotated[float | None, typer.Option(min=0.1, max=1000, help="By default the cameras'.")] = None,
    min_coverage: Annotated[float, typer.Option(min=0, max=1, help="Leave out frames that show less of it.")] = 0.5,
) -> None:
    """Cut upright, CAD-aligned pictures of components out of every frame that sees them."""
    from vaoi_station.errors import NotFoundError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.library.stitched_run import check_result
    from vaoi_station.rendering import compute_views, render

    recording = open_recording(case)
    head = recording.head
    cameras = read_calibration(calibration or case / "calibration.json", head.cameras).cameras(head.cameras)
    board_type = read_board_type(board or case / "board.json")
    stitch = read_stitch(result)
    check_result(stitch, head.rows, cameras, result)
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
            frame = recording.frame(view.camera, view.row)
            if frame is None:
                continue
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
