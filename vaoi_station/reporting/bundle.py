"""Write a run, with all files from which it was stitched, into one directory, so that it can be stitched elsewhere."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np

from vaoi_station.files import Recording, write_stitch
from vaoi_station.files.directories import new_directory
from vaoi_station.files.documents import write_bytes
from vaoi_station.reporting.figures import detection_arrays, link_arrays
from vaoi_station.reporting.html_report import write_report
from vaoi_station.reporting.stitched_run import StitchedRun

REPORT, RESULT, LINKS, REFERENCE = "report.html", "result.json", "links.npz", "reference"


def write_bundle(directory: Path, stitched: StitchedRun) -> None:
    """Write recording, calibration, board type, reference, result, links and report into a new directory.

    The bundle is itself a recording, so that `vaoi stitch` and `vaoi report` accept it. The arrays of links.npz are
    those of `link_arrays` and `detection_arrays` in `sections.embedded_data`; the latter have the prefix `sighting_`.

    Raises:
        InputError: the directory exists.
    """
    with new_directory(directory) as draft:
        _fill(draft, stitched)


def replay_command(directory: Path, stitched: StitchedRun) -> str:
    """Return the command that stitches the bundle again."""
    words = ["vaoi stitch", str(directory), "--method", stitched.result.method]
    if stitched.opened.reference:
        words += ["--reference", str(directory / REFERENCE)]
    return " ".join([*words, "--out again.json"])


def _fill(draft: Path, stitched: StitchedRun) -> None:
    o = stitched.opened
    _copy_recording(o.recording, draft, [p for key in o.present if (p := o.recording.frame_path(*key))])
    shutil.copyfile(o.calibration_path, draft / "calibration.json")
    if o.board_path:
        shutil.copyfile(o.board_path, draft / "board.json")
    if o.reference:
        shutil.copytree(o.reference.recording.directory, draft / REFERENCE, ignore=shutil.ignore_patterns("truth.json"))
    write_stitch(draft / RESULT, stitched.result)
    arrays = link_arrays(stitched) | {f"sighting_{k}": v for k, v in detection_arrays(stitched).items()}
    # Without pickle: the archive must be safe to load on another machine.
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **arrays)
    write_bytes(draft / LINKS, packed.getvalue())
    write_report(draft / REPORT, stitched)


def _copy_recording(recording: Recording, draft: Path, frames: list[Path]) -> None:
    """Copy head and frames of a recording, and no other files of its directory."""
    (draft / "frames").mkdir()
    for path in frames:
        shutil.copyfile(path, draft / "frames" / path.name)
    # The head comes last: a directory with a head counts as a complete recording.
    recording.copy_head(draft)
