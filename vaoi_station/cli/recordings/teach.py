"""`vaoi teach CASE --out DIR`: keep a recording as the reference of its board type."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def teach(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    out: Annotated[Path, typer.Option(help="Write the reference to this directory, which must not exist.")],
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
    confirm_orientation: Annotated[
        bool,
        typer.Option(
            "--confirm-orientation",
            help="You have checked that the board lies as its board type says, not turned by 180°.",
        ),
    ] = False,
    rotation: Annotated[
        int | None, typer.Option(help="Expected rotation of the board: 0, 90, 180 or 270 degrees [recording.json].")
    ] = None,
) -> None:
    """Stitch a recording and keep it as the reference against which later runs of its board type are placed."""
    from vaoi_station.stitching.recordings.references import teach as keep

    stitch = keep(
        case,
        calibration or case / "calibration.json",
        board or case / "board.json",
        out,
        confirm_orientation=confirm_orientation,
        rotation_deg=rotation,
    )
    typer.echo(f"{stitch.status}: standard deviation of positions {stitch.quality['cad_sigma_px']:.3f} px → {out}")
