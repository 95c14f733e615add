"""`vaoi teach CASE --out DIR`: keep a recording as the reference of its board type."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def teach(
    case: Annotated[Path, typer.Argument(help="Directory of the recording.")],
    out: Annotated[Path, typer.Option(help="Directory of the reference; must not exist.")],
    calibration: Annotated[Path | None, typer.Option(help="By default the recording's own.")] = None,
    board: Annotated[Path | None, typer.Option(help="Board type; by default the recording's own.")] = None,
) -> None:
    """Stitch a recording once and keep it; later runs of its board type are placed against it."""
    from vaoi_station.stitching.recordings.reference_directory import teach as keep

    stitch = keep(case, calibration or case / "calibration.json", board or case / "board.json", out)
    typer.echo(f"{stitch.status}: positions are good to {stitch.quality['cad_sigma_px']:.3f} px (1 σ) → {out}")
