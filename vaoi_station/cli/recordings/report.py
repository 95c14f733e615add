"""`vaoi report RUN --out report.html`: how a recorded run was stitched, as one HTML file."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Evidence(StrEnum):
    """Ways to stitch that can tell how they came to their result."""

    AUTO = "auto"
    FIDUCIALS = "fiducials"
    FEATURES = "features"
    REFERENCE = "reference"


def report(
    run: Annotated[Path, typer.Argument(help="Directory of the recording.")],
    out: Annotated[
        Path | None, typer.Option(help="Where the report is written [report.html, unless --bundle].")
    ] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="Directory to make: recording, documents, result, links, report.")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="By default the recording's own.")] = None,
    board: Annotated[Path | None, typer.Option(help="Board type; by default the recording's own.")] = None,
    reference: Annotated[Path | None, typer.Option(help="Directory made by `vaoi teach`.")] = None,
    method: Annotated[Evidence, typer.Option(help="Evidence to use.")] = Evidence.AUTO,
) -> None:
    """Stitch a recorded run and show how: one HTML file that needs nothing else."""
    from vaoi_station.errors import StateError
    from vaoi_station.reporting import restitch, write_bundle, write_report
    from vaoi_station.reporting.bundle import REPORT, replay_command
    from vaoi_station.stitching.recordings.opening import open_run

    if bundle is not None and bundle.exists():
        raise StateError(f"{bundle}: exists already.", action="Choose another directory, or remove this one.")
    opened = open_run(run, calibration=calibration, board=board, reference=reference, method=method.value)
    stitched = restitch(opened)
    if bundle is not None:
        write_bundle(bundle, stitched)
        typer.echo(
            f"{stitched.result.status}: {bundle / REPORT}; stitched again by: {replay_command(bundle, stitched)}"
        )
    if out is not None or bundle is None:
        path = out or Path("report.html")
        write_report(path, stitched)
        typer.echo(f"{stitched.result.status}: {path}")
    for reason in stitched.result.reasons:
        typer.echo(f"- {reason}")
