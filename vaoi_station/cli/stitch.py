"""`vaoi stitch CASE --out result.json`: stitch a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

if TYPE_CHECKING:
    from vaoi_station.stitching.method import MethodName


class Method(StrEnum):
    """Ways to stitch."""

    AUTO = "auto"
    FIDUCIALS = "fiducials"
    FEATURES = "features"
    REFERENCE = "reference"
    PAPER = "paper"


def stitch(
    case: Annotated[Path, typer.Argument(help="Directory of the recording.")],
    out: Annotated[Path, typer.Option(help="Where the result is written.")],
    calibration: Annotated[Path | None, typer.Option(help="By default the recording's own.")] = None,
    board: Annotated[Path | None, typer.Option(help="Board type; by default the recording's own.")] = None,
    reference: Annotated[Path | None, typer.Option(help="Directory made by `vaoi teach`.")] = None,
    method: Annotated[Method, typer.Option(help="Evidence to use.")] = Method.AUTO,
) -> None:
    """Stitch a recorded run: one matrix per frame, and C from CAD to tester."""
    from vaoi_station.errors import InputError
    from vaoi_station.files import open_recording, read_board_type, read_calibration, write_stitch
    from vaoi_station.stitching.by_paper import stitch_by_paper
    from vaoi_station.stitching.offline import stitch_frames
    from vaoi_station.stitching.taught import open_taught, with_reference
    from vaoi_station.stitching.work import Setup

    recording = open_recording(case)
    cameras = read_calibration(calibration or case / "calibration.json", len(recording.head.cameras))
    own = case / "board.json"
    board_type = read_board_type(board or own) if board or own.is_file() else None
    setup = Setup(
        cameras=cameras.cameras(recording.head.cameras),
        conveyor_mm_s=recording.head.conveyor_mm_s,
        trigger_period_s=recording.head.trigger_period_s,
        board_type=board_type,
        method=cast("MethodName", "auto" if method is Method.PAPER else method.value),
    )
    if method is Method.REFERENCE and reference is None:
        raise InputError("--method reference needs --reference DIR.", action="`vaoi teach` makes one.")
    taught = None
    if reference is not None:
        if board_type is None:
            raise InputError("--reference needs a board type.", action="Give one with --board.")
        taught = open_taught(reference, setup.cameras, board_type)
    reference_frame = taught.recording.frame if taught else None
    if method is Method.PAPER:
        result = stitch_by_paper(setup, recording.head, recording.frame)
    else:
        result = stitch_frames(with_reference(setup, taught), recording.head, recording.frame, reference_frame)
    write_stitch(out, result)
    sigma = result.quality.get("cad_sigma_px")
    typer.echo(f"{result.status}: {recording.head.rows} rows × {len(recording.head.cameras)} cameras → {out}")
    if sigma is not None:
        typer.echo(f"positions are good to {sigma:.3f} px (1 σ, worst corner of the board)")
    for reason in result.reasons:
        typer.echo(f"- {reason}")
