"""The report, from its parts."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.files.documents import write_bytes
from vaoi_station.reporting.drawing.page import page
from vaoi_station.reporting.restitched import Story
from vaoi_station.reporting.sections import fits, frames, graph, maps, motion, residuals, summary
from vaoi_station.reporting.sections import provenance as identity
from vaoi_station.reporting.sections.numbers import data_block


def report(story: Story) -> str:
    """The whole report as one HTML document."""
    name = story.opened.recording.directory.resolve().name
    sections = [
        summary.key_numbers(story),
        graph.tile_graph(story),
        frames.frame_table(story),
        motion.row_motion(story),
        residuals.residual_vectors(story),
        fits.seams(story),
        fits.fiducials(story),
        maps.surface(story),
        maps.components(story),
        identity.timings(story),
        identity.identity(story),
    ]
    head = frames.picture_store(story) + summary.head(story, name)
    return page(f"{name}: {story.stitch.status}", head, sections, data_block(story))


def write_report(path: Path, story: Story) -> None:
    """Write the report whole or not at all."""
    write_bytes(path, report(story).encode())
