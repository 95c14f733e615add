"""A scenario that films a given board type, in place of the board of a shipped scenario."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import tomlkit

from vaoi_station.errors import InputError
from vaoi_station.files.documents import read_toml, write_bytes
from vaoi_station.simulation.scenario import BoardSection
from vaoi_station.simulation.scenario_files import find_scenario, read_scenario, section_of

_BESIDE_MM = 4.0
"""Width that the cameras film on each side of the board, for its sway and turn, mm."""
_BEHIND_MM = 20.0
"""Length by which the longest board of the line exceeds the board, mm."""
MOST_CAMERAS = 6
LEAST_PX_PER_MM = 8.0
"""Resolution below which small parts and fiducials are too few pixels."""


def write_given_scenario(board: Path, scenario: str | Path, folder: Path) -> Path:
    """Write a scenario with a given board into a folder, and return its path.

    Cameras are added until they cover the board's width, at most `MOST_CAMERAS`; then the resolution is lowered.

    Raises:
        InputError: the board type is malformed, has no outline, or is too wide.
    """
    base = find_scenario(scenario)
    array = read_scenario(base).array
    section = section_of(BoardSection(), board.resolve())
    cameras, px_per_mm = _array_for(section.width_mm, array.width_px, array.px_per_mm, array.overlap, board)
    content: dict[str, Any] = read_toml(base)
    content["board"] = {"file": str(board.resolve())}
    content["array"] = content.get("array", {}) | {"cameras": cameras, "px_per_mm": px_per_mm}
    content["line"] = content.get("line", {}) | {"longest_board_mm": math.ceil(section.length_mm + _BEHIND_MM)}
    path = folder / "given-board.toml"
    write_bytes(path, tomlkit.dumps(content).encode())
    return path


def _array_for(width_mm: float, width_px: int, px_per_mm: float, overlap: float, board: Path) -> tuple[int, float]:
    """Return the number of cameras and the resolution with which an array covers a board."""
    wanted_mm = width_mm + 2 * _BESIDE_MM
    frame_mm = width_px / px_per_mm
    cameras = max(math.ceil((wanted_mm - frame_mm) / (frame_mm / overlap)) + 1, 2)
    if cameras <= MOST_CAMERAS:
        return cameras, px_per_mm
    lowered = math.floor(width_px * (1 + (MOST_CAMERAS - 1) / overlap) / wanted_mm * 100) / 100
    if lowered < LEAST_PX_PER_MM:
        widest = width_px * (1 + (MOST_CAMERAS - 1) / overlap) / LEAST_PX_PER_MM - 2 * _BESIDE_MM
        raise InputError(
            f"{board}: outline is {width_mm:.1f} mm wide, the demo films at most {widest:.0f} mm "
            f"({MOST_CAMERAS} cameras at {LEAST_PX_PER_MM:g} px/mm).",
            action="Write a scenario with more cameras, and name the board there ([board] file).",
        )
    return MOST_CAMERAS, lowered
