"""Assemble the report from its sections."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.files.documents import write_bytes
from vaoi_station.reporting.drawing.html_page import page
from vaoi_station.reporting.sections import (
    board_maps,
    frame_table,
    provenance,
    residual_vectors,
    row_motion,
    seams_and_fiducials,
    summary,
    tile_graph,
)
from vaoi_station.reporting.sections.embedded_data import data_block
from vaoi_station.reporting.stitched_run import StitchedRun


def render_report(stitched: StitchedRun) -> str:
    """Return the whole report as one HTML document."""
    name = stitched.opened.recording.directory.resolve().name
    sections = [
        summary.key_numbers(stitched),
        tile_graph.tile_graph(stitched),
        frame_table.frame_table(stitched),
        row_motion.row_motion(stitched),
        residual_vectors.residual_vectors(stitched),
        seams_and_fiducials.seams(stitched),
        seams_and_fiducials.fiducials(stitched),
        board_maps.surface(stitched),
        board_maps.components(stitched),
        provenance.timings(stitched),
        provenance.identity(stitched),
    ]
    head = frame_table.picture_store(stitched) + summary.head(stitched, name)
    return page(f"{name}: {stitched.result.status}", head, sections, data_block(stitched))


def write_report(path: Path, stitched: StitchedRun) -> None:
    """Write the report as a file. The file is complete, or it is not written at all."""
    write_bytes(path, render_report(stitched).encode())
