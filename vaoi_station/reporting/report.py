"""Write the report of a run, and the bundle: the report with everything that is needed to stitch the run again."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np

from vaoi_station.files import write_stitch
from vaoi_station.files.directories import new_directory
from vaoi_station.files.documents import write_bytes
from vaoi_station.reporting import figures, maps
from vaoi_station.reporting.drawing import page
from vaoi_station.reporting.stitched_run import StitchedRun

REPORT, RESULT, LINKS, REFERENCE = "report.html", "result.json", "links.npz", "reference"


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
    return page(f"{name}: {stitched.result.status}", head, sections, figures.data_block(stitched))


def write_report(path: Path, stitched: StitchedRun) -> None:
    """Write the report as a file. The file is complete, or it is not written at all."""
    write_bytes(path, render_report(stitched).encode())


def write_bundle(directory: Path, stitched: StitchedRun) -> None:
    """Write recording, calibration, board type, reference, result, links and report into a new directory.

    The bundle is itself a recording, so that `vaoi stitch` and `vaoi report` accept it. The arrays of links.npz are
    those of `link_arrays`, and of `detection_arrays` with the prefix `sighting_`. `InputError`: the directory exists.
    """
    o = stitched.opened
    with new_directory(directory) as draft:
        (draft / "frames").mkdir()
        for key in o.present:
            if path := o.recording.frame_path(*key):
                shutil.copyfile(path, draft / "frames" / path.name)
        o.recording.copy_head(draft)
        shutil.copyfile(o.calibration_path, draft / "calibration.json")
        if o.board_path:
            shutil.copyfile(o.board_path, draft / "board.json")
        if o.reference:
            untold = shutil.ignore_patterns("truth.json")
            shutil.copytree(o.reference.recording.directory, draft / REFERENCE, ignore=untold)
        write_stitch(draft / RESULT, stitched.result)
        sightings = {f"sighting_{k}": v for k, v in figures.detection_arrays(stitched).items()}
        packed = io.BytesIO()
        # Without pickle: the archive must be safe to load on another machine.
        np.savez_compressed(packed, allow_pickle=False, **figures.link_arrays(stitched), **sightings)
        write_bytes(draft / LINKS, packed.getvalue())
        write_report(draft / REPORT, stitched)


def replay_command(directory: Path, stitched: StitchedRun) -> str:
    """Return the command that stitches the bundle again."""
    reference = f" --reference {directory / REFERENCE}" if stitched.opened.reference else ""
    return f"vaoi stitch {directory} --method {stitched.result.method}{reference} --out again.json"
