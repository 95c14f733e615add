"""What lies in the ring after a run, held against the film: every pixel of every frame.

The ring is mapped as tester software would map it, read-only, while its memory still belongs to the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.acquisition.ring.ring_layout import EMPTY, NO_ROW
from vaoi_station.acquisition.ring.ring_layout import OK as WHOLE
from vaoi_station.rig.devices.virtual_camera import lit
from vaoi_station.rig.line.stage import Passing

MONO_8, MONO_16 = 0x01080001, 0x01100007


@dataclass(frozen=True)
class Sighting:
    """(camera, row) by what their memory holds."""

    proven: frozenset[tuple[int, int]]
    """Whole, and every pixel is that of the film's frame of this camera and row."""
    partly: frozenset[tuple[int, int]]
    """Incomplete; every pixel that is not black is the film's."""
    wrong: dict[tuple[int, int], str]
    """Anything else, in words."""
    looked: bool = True
    """Whether the memory was still the run's."""


def look_at(ring: Ring, bay: int, passing: Passing) -> Sighting:
    """Compare one bay of the ring with the film of the board that was filmed into it.

    Args:
        ring: the station's.
        bay: the one of the run.
        passing: which board, and under which light its rows were fired.
    """
    frames = passing.film.map()
    lights = {fired.row: fired.light for fired in passing.fired if fired.row is not None}
    generation = ring.generation(bay)
    proven: set[tuple[int, int]] = set()
    partly: set[tuple[int, int]] = set()
    wrong: dict[tuple[int, int], str] = {}
    for camera in range(ring.layout.cameras):
        for k in range(ring.layout.slots_per_camera):
            slot = ring.slot(bay, camera, k)
            _, state, row, _ = ring.record(slot)
            if state == EMPTY or row == NO_ROW:
                continue
            cell = (camera, row)
            shape = ring.layout.frames[camera]
            mono = MONO_8 if shape.nbytes == shape.width * shape.height else MONO_16
            why = _compare(ring.memory(slot), frames, cell, lights, mono, whole=state == WHOLE)
            if why:
                wrong[cell] = why
            else:
                (proven if state == WHOLE else partly).add(cell)
    looked = ring.generation(bay) == generation
    return Sighting(frozenset(proven), frozenset(partly), wrong, looked)


def filmed_bays(station: Mapping[str, Any]) -> dict[str, int]:
    """Run → bay, by `GET station`, of the runs whose frames are all there."""
    return {
        str(bay["run"]): int(bay["bay"]) for bay in station["ring"]["bays"] if bay["use"] in ("stitching", "finished")
    }


def attach(station: Mapping[str, Any]) -> Ring:
    """The ring that `GET station` names."""
    return Ring.attach(Path(station["ring"]["path"]))


def _compare(
    pixels: NDArray[np.uint8],
    frames: NDArray[np.uint8],
    cell: tuple[int, int],
    lights: Mapping[int, list[float]],
    mono: int,
    *,
    whole: bool,
) -> str:
    camera, row = cell
    if row not in lights:
        return "a row that was never fired"
    expected = lit(frames[row, camera], lights[row][camera], mono)
    if whole:
        return "" if np.array_equal(pixels, expected) else _whose(pixels, frames, camera, row)
    strange = (pixels != expected) & (pixels != 0)
    return f"{int(strange.sum())} pixels of another picture" if strange.any() else ""


def _whose(pixels: NDArray[np.uint8], frames: NDArray[np.uint8], camera: int, row: int) -> str:
    """Whether it is at least a frame of this film."""
    for other, of_row in enumerate(frames):
        for place, frame in enumerate(of_row):
            if np.array_equal(pixels, frame):
                return f"it is the frame of camera {place}, row {other}"
    return f"it is no frame of this board as camera {camera} saw it in row {row}"
