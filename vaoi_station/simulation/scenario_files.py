"""Scenario files: the shipped ones, and how a file becomes a `Scenario`, with the board type that it names."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import read_board_type
from vaoi_station.files.documents import parse, read_toml
from vaoi_station.model import MM_PER_UNIT, Fiducial
from vaoi_station.simulation.scenario import BoardSection, FiducialMark, Scenario

_SHIPPED = Path(str(resources.files("vaoi_station.simulation") / "scenarios"))


def read_scenario(path: Path) -> Scenario:
    """Read a scenario file. The relative path of a board type counts from the folder of this file."""
    scenario = parse(Scenario, read_toml(path), path)
    if scenario.board.file is None:
        return scenario
    board = section_of(scenario.board, path.resolve().parent / scenario.board.file)
    return scenario.model_copy(update={"board": board})


def section_of(section: BoardSection, file: Path) -> BoardSection:
    """Return the board section with name, size, fiducials, unit, axes and side of a board type."""
    given = read_board_type(file)
    if not given.outline:
        raise InputError(f"{file}: outline is absent.", action="Import it again from a file that has the outline.")
    corners, mm = np.asarray(given.outline), MM_PER_UNIT[given.unit]
    low = corners.min(0)
    width_mm, length_mm = (float(v) for v in (corners.max(0) - low) * mm)
    flip_x, flip_y = given.side == "bottom", given.y_axis == "up"

    def placed(mark: Fiducial) -> FiducialMark:
        x, y = (np.array([mark.x, mark.y]) - low) * mm
        return FiducialMark(
            x_mm=float(width_mm - x if flip_x else x),
            y_mm=float(length_mm - y if flip_y else y),
            diameter_mm=mark.diameter * mm,
            shape=mark.shape,
        )

    known = {
        "file": file, "name": given.name, "unit": given.unit, "y_axis": given.y_axis, "side": given.side,
        "origin": tuple(map(float, low)), "width_mm": width_mm, "length_mm": length_mm,
        "fiducials": tuple(map(placed, given.fiducials)),
    }  # fmt: skip
    return parse(BoardSection, section.model_dump() | known, file)


def find_scenario(given: str | Path) -> Path:
    """Return the path of a scenario file, given as a path or as the name of a shipped scenario.

    A file takes precedence over a shipped scenario of the same name, a folder does not: recordings are often written to
    a folder that has the name of their scenario.
    """
    path = Path(given)
    if path.suffix or path.is_file():
        return path.resolve()
    if path.is_dir() and str(given) not in _shipped():
        raise NotFoundError(f"{given}: is a folder, not a scenario file.", action="Give the TOML file itself.")
    return scenario_path(str(given))


def _shipped() -> list[str]:
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def scenario_path(name: str) -> Path:
    """Return the path of a scenario file that comes with the software: "demo", "light", "paper" or "small"."""
    if name not in _shipped():
        known = ", ".join(_shipped())
        raise NotFoundError(f"there is no scenario {name!r}.", action=f"Choose one of: {known}; or give a file.")
    return _SHIPPED / f"{name}.toml"
