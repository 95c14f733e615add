"""`vaoi report RUN --out report.html`: show how a recorded run is stitched, as one HTML file."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Evidence(StrEnum):
    """The methods whose evidence a report can show. The paper's method is not among them: it keeps no evidence."""

    AUTO = "auto"
    FIDUCIALS = "fiducials"
    FEATURES = "features"
    REFERENCE = "reference"


def report(
    run: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    out: Annotated[
        Path | None, typer.Option(help="Write the report to this file [report.html, unless --bundle].")
    ] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="Create this directory with recording, documents, result, links and report.")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [RUN/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [RUN/board.json].")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Use this reference, a directory written by `vaoi teach`.")
    ] = None,
    method: Annotated[Evidence, typer.Option(help="Use this evidence.")] = Evidence.AUTO,
    rotation: Annotated[
        int | None, typer.Option(help="Expected rotation of the board: 0, 90, 180 or 270 degrees [recording.json].")
    ] = None,
) -> None:
    """Stitch a recorded run and show the evidence in one HTML file."""
    from vaoi_station.files.atomic_directory import refuse_existing
    from vaoi_station.reporting import restitch, write_bundle, write_report
    from vaoi_station.reporting.bundle import REPORT, replay_command
    from vaoi_station.stitching.recordings.opening import open_run

    # The target is checked first, because stitching the run takes seconds.
    if bundle is not None:
        refuse_existing(bundle)
    opened = open_run(
        run, calibration=calibration, board=board, reference=reference, method=method.value, rotation_deg=rotation
    )
    stitched = restitch(opened)
    if bundle is not None:
        write_bundle(bundle, stitched)
        typer.echo(
            f"{stitched.result.status}: {bundle / REPORT}; to stitch it again: {replay_command(bundle, stitched)}"
        )
    if out is not None or bundle is None:
        path = out or Path("report.html")
        write_report(path, stitched)
        typer.echo(f"{stitched.result.status}: {path}")
    for reason in stitched.result.reasons:
        typer.echo(f"- {reason}")
