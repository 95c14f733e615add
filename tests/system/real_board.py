"""A station with the array and the line of a recorded case, which replays the recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.config import StationConfig
from vaoi_station.files import open_recording, read_board_type, write_board_type

BAYS = 3
"""Number of runs whose frames the ring of the station holds."""


def station_of(case: Path, directory: Path, **replay: Any) -> StationConfig:
    """Return the configuration of the station; the position of the board on the belt is not known beforehand.

    Args:
        case: the recording.
        directory: an existing directory for the station's files.
        replay: keys of the table [replay].
    """
    head, board_type = open_recording(case).head, read_board_type(case / "board.json")
    write_board_type(directory / "board-types" / f"{board_type.name}.json", board_type)
    (directory / "shm").mkdir()
    speed_mm_s = float(np.hypot(*head.conveyor_mm_s))
    return StationConfig.model_validate(
        {
            "name": "real-board",
            "calibration": case / "calibration.json",
            "board_types": directory / "board-types",
            "data": directory / "data",
            "line": {
                "conveyor_mm_s": head.conveyor_mm_s,
                "barrier_mm": 0.0,
                "start_delay_s": 0.0,
                "trigger_period_s": head.trigger_period_s,
                "tail_s": 0.0,
                "longest_board_mm": speed_mm_s * head.trigger_period_s * head.rows,
                "expected_board": {"tolerance_mm": 1000.0},
            },
            "cameras": [
                {
                    "name": f"c{n}",
                    "backend": "replay",
                    "width": camera.width,
                    "height": camera.height,
                    "exposure_us": camera.exposure_us,
                }
                for n, camera in enumerate(head.cameras)
            ],
            "controller": {"backend": "replay"},
            "replay": {"recordings": [case], **replay},
            # The recorded boards follow closely; frames that were kept for longer would make the line miss boards.
            "ring": {"directory": directory / "shm", "runs": BAYS, "keep_s": 0.1},
        }
    )
