"""Make recordings of simulated boards whose truth is known."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.library.arguments import require_path, require_whole
from vaoi_station.library.recorded_run import RecordedRun, open_recording
from vaoi_station.simulation import Twin, find_scenario, read_scenario
from vaoi_station.simulation.recording_writer import write_passage


def simulate(scenario: str | Path, directory: str | Path, *, board: int = 0) -> RecordedRun:
    """Record one board of the digital twin, with calibration, board type and truth.json.

    Args:
        scenario: a scenario file (TOML), or the name of one that comes with the package, e.g. "small" or "demo".
            A file takes precedence over a shipped scenario of the same name; a folder does not.
        directory: directory for the recording; it must not contain one already.
        board: index of the board; boards of one scenario differ in noise, motion and faults.

    Raises:
        InputError: an argument is not of its type, the scenario is malformed, or the directory already holds a
            recording.
        NotFoundError: there is no such scenario.
    """
    require_path("simulate", "scenario", scenario)
    out = require_path("simulate", "directory", directory)
    require_whole("simulate", "board", board, 0, 1_000_000)
    if (out / "recording.json").exists():
        raise InputError(f"{out}: already holds a recording.", action="Give another directory, or remove this one.")
    twin = Twin(read_scenario(find_scenario(scenario)))
    write_passage(twin.passage(board), out)
    return open_recording(out)
