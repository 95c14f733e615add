"""Compare every pixel that a run has in the ring with the rendered frames.

The ring is mapped read-only, as the software of a tester would map it, while the bay still belongs to the run.
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
from vaoi_station.rig.devices.virtual_camera import apply_brightness
from vaoi_station.rig.line.virtual_line import BoardPassage

MONO_8, MONO_16 = 0x01080001, 0x01100007


@dataclass(frozen=True)
class RingCheck:
    """The check of one bay: its frames, as (camera, row), sorted by what their memory contains."""

    proven: frozenset[tuple[int, int]]
    """Complete frames of which every pixel equals the frame rendered for that camera and row."""
    partial: frozenset[tuple[int, int]]
    """Incomplete frames of which every pixel is black or equals the rendered pixel."""
    wrong: dict[tuple[int, int], str]
    """All other frames, with a description of the difference."""
    valid: bool = True
    """Whether the bay still belonged to the run after the comparison; otherwise the comparison is not valid."""


def check_bay(ring: Ring, bay: int, passage: BoardPassage) -> RingCheck:
    """Compare one bay of the ring with the rendered frames of the board that was recorded into it.

    Args:
        ring: the station's ring.
        bay: index of the run's bay.
        passage: the passage of the board, with its rendered frames and the brightness of each row.
    """
    frames = passage.rendered.map_frames()
    brightness = {fired.row: fired.brightness for fired in passage.fired if fired.row is not None}
    generation = ring.generation(bay)
    proven: set[tuple[int, int]] = set()
    partial: set[tuple[int, int]] = set()
    wrong: dict[tuple[int, int], str] = {}
    for camera in range(ring.layout.cameras):
        for k in range(ring.layout.slots_per_camera):
            slot = ring.slot(bay, camera, k)
            _, state, row, _ = ring.slot_record(slot)
            if state == EMPTY or row == NO_ROW:
                continue
            cell = (camera, row)
            shape = ring.layout.frames[camera]
            mono = MONO_8 if shape.nbytes == shape.width * shape.height else MONO_16
            difference = _compare(ring.memory(slot), frames, cell, brightness, mono, whole=state == WHOLE)
            if difference:
                wrong[cell] = difference
            else:
                (proven if state == WHOLE else partial).add(cell)
    # The generation of a bay changes when the station gives the bay to the next board, even during this comparison.
    valid = ring.generation(bay) == generation
    return RingCheck(frozenset(proven), frozenset(partial), wrong, valid)


def bays_to_check(station: Mapping[str, Any]) -> dict[str, int]:
    """Return run id → bay, for runs whose frames have all arrived. `station` is the JSON of `GET station`."""
    return {
        str(bay["run"]): int(bay["bay"]) for bay in station["ring"]["bays"] if bay["use"] in ("stitching", "finished")
    }


def attach(station: Mapping[str, Any]) -> Ring:
    """Map the station's ring read-only; `station` is the JSON of `GET station`, which has the path of the ring."""
    return Ring.attach(Path(station["ring"]["path"]))


def _compare(
    pixels: NDArray[np.uint8],
    frames: NDArray[np.uint8],
    cell: tuple[int, int],
    brightness: Mapping[int, list[float]],
    mono: int,
    *,
    whole: bool,
) -> str:
    camera, row = cell
    if row not in brightness:
        return "a row that was never fired"
    expected = apply_brightness(frames[row, camera], brightness[row][camera], mono)
    if whole:
        return "" if np.array_equal(pixels, expected) else _identify(pixels, frames, camera, row)
    foreign = (pixels != expected) & (pixels != 0)
    return f"{int(foreign.sum())} pixels of another picture" if foreign.any() else ""


def _identify(pixels: NDArray[np.uint8], frames: NDArray[np.uint8], camera: int, row: int) -> str:
    """Return a text that states which rendered frame of the board has these pixels; empty if none has."""
    for other, of_row in enumerate(frames):
        for place, frame in enumerate(of_row):
            if np.array_equal(pixels, frame):
                return f"it is the frame of camera {place}, row {other}"
    return f"it is no frame of this board as camera {camera} saw it in row {row}"
