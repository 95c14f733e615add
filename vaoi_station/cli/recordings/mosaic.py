"""`vaoi mosaic CASE --result result.json --out board.tif`: the whole board as one picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def mosaic(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    out: Annotated[Path, typer.Option(help="Write the picture to this file, a tiled, pyramidal TIFF.")],
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
    px_per_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="Resolution of the picture [that of the cameras].")
    ] = None,
    light: Annotated[str | None, typer.Option(help="Take only rows of this light [that of most rows].")] = None,
    exposure: Annotated[
        float | None, typer.Option(min=0, help="Take only frames of this exposure in µs [each camera's usual one].")
    ] = None,
    hdr: Annotated[bool, typer.Option("--hdr", help="Merge all exposures to linear radiance (32-bit float).")] = False,
    flatfield: Annotated[
        Path | None, typer.Option(help="Use the flat fields that `vaoi flatfield` wrote to this directory.")
    ] = None,
    heights: Annotated[
        Path | None, typer.Option(help="With --hdr: take the heights of bodies from this file (of `vaoi heights`).")
    ] = None,
    region: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Two opposite corners X0 Y0 X1 Y1 in CAD coordinates [the whole board]."),
    ] = None,
) -> None:
    """Write the whole board, or a region of it, as one picture (tiled, pyramidal TIFF)."""
    from vaoi_station.library.mosaic_file import MosaicOrder, write_board

    order = MosaicOrder(
        case,
        result,
        out,
        calibration=calibration,
        board=board,
        px_per_mm=px_per_mm,
        light=light,
        exposure_us=exposure,
        hdr=hdr,
        flatfield=flatfield,
        heights=heights,
        region=region,
    )
    for line in write_board(order):
        typer.echo(line)
