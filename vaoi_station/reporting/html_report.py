"""Assemble the report from its sections."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.files.documents import write_bytes
from vaoi_station.reporting import figures, maps
from vaoi_station.reporting.drawing import page
from vaoi_station.reporting.figures import data_block
from vaoi_station.reporting.stitched_run import StitchedRun


def render_report(stitched: StitchedRun) -> str:
    """Return the whole report as one HTML document."""
    name = stitched.opened.recording.directory.resolve().name
    sections = [
        figures.key_numbers(stitched),
        maps.tile_graph(stitched),
        figures.frame_table(stitched),
        figures.row_motion(stitched),
        maps.residual_vectors(stitched),
        figures.seams(stitched),
        figures.fiducials(stitched),
        maps.surface(stitched),
        maps.components(stitched),
        figures.timings(stitched),
        figures.identity(stitched),
    ]
    head = figures.picture_store(stitched) + figures.head(stitched, name)
    return page(f"{name}: {stitched.result.status}", head, sections, data_block(stitched))


def write_report(path: Path, stitched: StitchedRun) -> None:
    """Write the report as a file. The file is complete, or it is not written at all."""
    write_bytes(path, render_report(stitched).encode())
