"""`vaoi simulate`: film a board of the digital twin, and write the recording and its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            help="Scenario file (TOML), or the name of a shipped scenario: demo, light, small. A file takes precedence "
            "over a shipped scenario of the same name; a folder does not."
        ),
    ] = "demo",
    *,
    out: Annotated[Path, typer.Option(help="Write the recording to this directory; it is created if necessary.")],
    board: Annotated[int, typer.Option(min=0, help="Film this board of the scenario, counted from 0.")] = 0,
    truth: Annotated[bool, typer.Option(help="Write truth.json, with which results can be compared.")] = True,
    calibration_board: Annotated[
        bool, typer.Option("--calibration-board", help="Film the calibration board instead, and write its layout.json.")
    ] = False,
) -> None:
    """Film a board with simulated cameras; write recording, calibration, board type and truth."""
    from vaoi_station.errors import InputError
    from vaoi_station.simulation import Twin, find_scenario, read_scenario
    from vaoi_station.simulation.calibration_board import write_calibration_recording
    from vaoi_station.simulation.recording_writer import write_passage

    # Frames of two boards in one directory would be taken for one recording.
    if (out / "recording.json").exists():
        raise InputError(f"{out}: already holds a recording.", action="Give another --out, or remove this directory.")
    twin = Twin(read_scenario(find_scenario(scenario)))
    if calibration_board:
        recording = write_calibration_recording(twin, out, with_truth=truth)
        print(f"{out}: calibration board, {len(recording.head.cameras)} cameras")
        return
    recording = write_passage(twin.passage(board), out, with_truth=truth)
    head, missing = recording.head, len(recording.head.missing)
    lost = f", {missing} frames missing" if missing else ""
    print(f"{out}: board {board} of {twin.board_type.name!r}, {len(head.cameras)} cameras × {head.rows} rows{lost}")
