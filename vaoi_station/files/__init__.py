"""The file formats of `docs/formats.md`, read and written in one place.

Readers refuse what they do not understand and name the file and the key; writers never leave a
half-written file behind.
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
