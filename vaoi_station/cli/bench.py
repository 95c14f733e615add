"""`vaoi bench [--json FILE]`: how fast stitching and rendering are here, as ratios in one run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from vaoi_station.errors import InputError


def bench(
    json: Annotated[Path | None, typer.Option(help="Also write the figures to this file.")] = None,
    case: Annotated[Path | None, typer.Option(help="Recording to measure on; by default a board of the twin.")] = None,
    repetitions: Annotated[int, typer.Option(min=1, max=100, help="Of each measurement; the median counts.")] = 5,
    marks: Annotated[bool, typer.Option("--marks", help="Measure how well and how fast marks are found.")] = False,
    plot: Annotated[Path | None, typer.Option(help="With --marks: draw the S-curve to this SVG file.")] = None,
) -> None:
    """Measure stitching and rendering on frames in memory, one thread, beside the paper's method; or marks."""
    from vaoi_station.benchmarks.frames import of_recording, of_twin
    from vaoi_station.benchmarks.measure import measure
    from vaoi_station.files.documents import write_json

    if plot is not None and not marks:
        raise InputError("--plot belongs to --marks.", action="Add --marks, or leave it out.")
    if marks:
        document = _marks(plot)
        if json is not None:
            write_json(json, document)
        return
    figures = measure(of_recording(case) if case else of_twin(), repetitions)
    for key, value in figures.document().items():
        typer.echo(f"{key:28s} {value}")
    if json is not None:
        write_json(json, figures.document())


def _marks(plot: Path | None) -> dict[str, Any]:
    from vaoi_station.benchmarks.marks import measure_marks
    from vaoi_station.benchmarks.s_curve import draw
    from vaoi_station.files.documents import write_bytes

    figures = measure_marks()
    for line in figures.lines():
        typer.echo(line)
    typer.echo(f"whole frame ({figures.material}): {figures.whole_frame_ms} ms")
    if plot is not None:
        write_bytes(plot, draw(figures.curves).encode())
    return figures.document()
