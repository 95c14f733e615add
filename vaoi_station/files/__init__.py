"""Read and write the file formats of `docs/formats.md`.

Readers refuse unknown content and name the file and the key. Writers never leave an incomplete file.
"""

from vaoi_station.files.board_types import read_board_type, write_board_type
from vaoi_station.files.calibrations import read_calibration, write_calibration
from vaoi_station.files.recordings import Recording, open_recording, write_recording
from vaoi_station.files.results import read_stitch, write_stitch

__all__ = [
    "Recording",
    "open_recording",
    "read_board_type",
    "read_calibration",
    "read_stitch",
    "write_board_type",
    "write_calibration",
    "write_recording",
    "write_stitch",
]
