"""`vaoi bench [--json FILE]`: how fast stitching and rendering are here, as ratios in one run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def bench(
    json: Annotated[Path | None, typer.Option(help="Also write the figures to this file.")] = None,
    case: Annotated[Path | None, typer.Option(help="Recording to measure on; by default a board of the twin.")] = None,
    repetitions: Annotated[int, typer.Option(min=1, max=100, help="Of each measurement; the median counts.")] = 5,
) -> None:
    """Measure stitching and rendering on frames in memory, one thread, beside the paper's method."""
    from vaoi_station.benchmarks.frames import of_recording, of_twin
    from vaoi_station.benchmarks.measure import measure
    from vaoi_station.files.documents import write_json

    figures = measure(of_recording(case) if case else of_twin(), repetitions)
    for key, value in figures.document().items():
        typer.echo(f"{key:28s} {value}")
    if json is not None:
        write_json(json, figures.document())
