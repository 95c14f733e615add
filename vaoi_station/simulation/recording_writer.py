"""Write a passage as a recording on disk: frames, calibration, board type and truth."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.files import Recording, write_board_type, write_calibration, write_recording
from vaoi_station.files.documents import write_json
from vaoi_station.simulation.twin import Passage


def write_passage(passage: Passage, directory: Path, *, with_truth: bool = True) -> Recording:
    """Write a passage as a recording into a directory. Frames that do not arrive completely are listed as missing."""
    twin = passage.twin
    write_calibration(directory / "calibration.json", twin.calibration)
    write_board_type(directory / "board.json", twin.board_type)
    if with_truth:
        write_json(directory / "truth.json", passage.truth())
    return write_recording(directory, passage.head(), passage.frames())
