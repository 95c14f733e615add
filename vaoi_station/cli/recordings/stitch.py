"""`vaoi stitch CASE --out result.json`: stitch a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

if TYPE_CHECKING:
    from vaoi_station.stitching.matching.evidence import MethodName


class Method(StrEnum):
    """The methods of stitching."""

    AUTO = "auto"
    FIDUCIALS = "fiducials"
    FEATURES = "features"
    REFERENCE = "reference"
    PAPER = "paper"


def stitch(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    out: Annotated[Path, typer.Option(help="Write the result to this file.")],
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Use this reference, a directory written by `vaoi teach`.")
    ] = None,
    method: Annotated[Method, typer.Option(help="Use this evidence, or the paper's method.")] = Method.AUTO,
    rotation: Annotated[
        int | None, typer.Option(help="Expected rotation of the board: 0, 90, 180 or 270 degrees [recording.json].")
    ] = None,
) -> None:
    """Stitch a recorded run: compute one matrix per frame, and C from CAD to tester."""
    from vaoi_station.errors import InputError
    from vaoi_station.files import write_stitch
    from vaoi_station.stitching.paper_method import stitch_by_paper
    from vaoi_station.stitching.recordings.opening import open_run
    from vaoi_station.stitching.recordings.origin import ESTIMATED_BITS, with_origin
    from vaoi_station.stitching.work import stitch_frames

    # The paper's method does not use this kind of evidence, but opening a run requires one.
    evidence = cast("MethodName", "auto" if method is Method.PAPER else method.value)
    opened = open_run(
        case, calibration=calibration, board=board, reference=reference, method=evidence, rotation_deg=rotation
    )
    recording = opened.recording
    # Overwriting one of these input files with the result would make the recording unusable.
    if out.resolve() in {(case / name).resolve() for name in ("recording.json", "calibration.json", "board.json")}:
        raise InputError(f"{out}: is a file of the recording and is not overwritten.", action="Give another --out.")
    if method is Method.PAPER:
        result = stitch_by_paper(opened.setup, recording.head, recording.frame)
    else:
        reference_frame = opened.reference.recording.frame if opened.reference else None
        result = stitch_frames(opened.setup, recording.head, recording.frame, reference_frame)
    result = with_origin(result, recording, opened.calibration, opened.setup.board_type)
    write_stitch(out, result)
    sigma = result.quality.get("cad_sigma_px")
    typer.echo(f"{result.status}: {recording.head.rows} rows × {len(recording.head.cameras)} cameras → {out}")
    if sigma is not None:
        typer.echo(f"standard deviation of positions: {sigma:.3f} px (worst corner of the board)")
    if (bits := result.quality.get(ESTIMATED_BITS)) is not None:
        typer.echo(f"frames use {bits} of 16 bits, by an estimate: state cameras[].bits in recording.json")
    for reason in result.reasons:
        typer.echo(f"- {reason}")
