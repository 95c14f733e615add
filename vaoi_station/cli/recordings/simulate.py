"""`vaoi simulate`: film a board of the digital twin into a recording, with the truth to score against."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    scenario: Annotated[
        str, typer.Argument(help="Scenario file (TOML), or the name of one that comes with the software: demo, small.")
    ] = "demo",
    *,
    out: Annotated[Path, typer.Option(help="Directory of the recording; made if need be.")],
    board: Annotated[int, typer.Option(min=0, help="Which of the scenario's boards, counted from 0.")] = 0,
    truth: Annotated[bool, typer.Option(help="Write truth.json, to score results against.")] = True,
    calibration_board: Annotated[
        bool, typer.Option("--calibration-board", help="Film the calibration board instead, with its layout.json.")
    ] = False,
) -> None:
    """Film a board with simulated cameras: a recording, its calibration, its board type, and the truth."""
    from vaoi_station.errors import InputError
    from vaoi_station.simulation import Twin, read_scenario, scenario_path
    from vaoi_station.simulation.calibration_board import write_calibration_recording
    from vaoi_station.simulation.recording_writer import write_passage

    if (out / "recording.json").exists():
        raise InputError(f"{out}: already holds a recording.", action="Give another directory, or remove this one.")
    named = Path(scenario).suffix == "" and not Path(scenario).exists()
    twin = Twin(read_scenario(scenario_path(scenario) if named else Path(scenario)))
    if calibration_board:
        recording = write_calibration_recording(twin, out, with_truth=truth)
        print(f"{out}: calibration board, {len(recording.head.cameras)} cameras")
        return
    recording = write_passage(twin.passage(board), out, with_truth=truth)
    head, missing = recording.head, len(recording.head.missing)
    lost = f", {missing} frames missing" if missing else ""
    print(f"{out}: board {board} of {twin.board_type.name!r}, {len(head.cameras)} cameras × {head.rows} rows{lost}")
