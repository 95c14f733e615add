"""Make recordings of simulated boards whose truth is known."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.library.recorded_run import RecordedRun, open_recording
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


def simulate(scenario: str | Path, directory: str | Path, *, board: int = 0) -> RecordedRun:
    """Record one board of the digital twin, with calibration, board type and truth.json.

    Args:
        scenario: a scenario file (TOML), or the name of one that comes with the package, e.g. "small" or "demo".
        directory: directory for the recording; it must not contain one already.
        board: index of the board; boards of one scenario differ in noise, motion and faults.

    Raises:
        InputError: the scenario is malformed, or the directory already holds a recording.
    """
    out = Path(directory)
    if (out / "recording.json").exists():
        raise InputError(f"{out}: already holds a recording.", action="Give another directory, or remove this one.")
    if board < 0:
        raise InputError.field("simulate", "board", board, "0 or more")
    path = Path(scenario)
    # A file in the working directory takes precedence over a shipped scenario of the same name.
    named = path.suffix == "" and not path.exists()
    twin = Twin(read_scenario(scenario_path(str(scenario)) if named else path))
    write_passage(twin.passage(board), out)
    return open_recording(out)
