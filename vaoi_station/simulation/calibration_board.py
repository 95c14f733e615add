"""Simulate a recording of the calibration board: one frame per camera of the board at rest, with layout and truth.

The coordinates of the calibration board are the tester coordinates. The cameras are mounted slightly off their nominal
positions. A calibration has to determine these deviations.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.files import Recording, write_recording
from vaoi_station.files.documents import write_json
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import RecordingHead
from vaoi_station.simulation.board.artwork import Artwork
from vaoi_station.simulation.board.canvas import Canvas, to_bytes
from vaoi_station.simulation.imaging.scene import LitTextures, Scene
from vaoi_station.simulation.imaging.sensor import expose, generator, vignette
from vaoi_station.simulation.scenario import BoardSection, LightSection
from vaoi_station.simulation.twin import TEXTURE_PER_PIXEL, Twin

_BORDER_MM = 5.0
_ARM = 0.25
"""Width of a cross' arm as a share of its size."""


def mark_places_mm(twin: Twin) -> Floats:
    """Return the tester coordinates (k, 2) of the crosses, mm: a grid inside the nominal view of each camera."""
    array, n = twin.scenario.array, twin.scenario.calibration_board.marks_per_axis
    places = []
    for i in range(array.cameras):
        w, h = array.camera_view_mm(i)
        x, y = (np.linspace(0.2, 0.8, n) - 0.5) * w, (np.linspace(0.18, 0.82, n) - 0.5) * h
        places += [(array.center_mm(i) + u, v) for v in y for u in x]
    return np.array(places)


def layout(twin: Twin) -> dict[str, Any]:
    """Return the content of layout.json: shape and positions of the marks on the board."""
    board = twin.scenario.calibration_board
    size, polarity = board.mark_mm, "dark" if board.mark_grey < board.board_grey else "light"
    return {
        "unit": "mm",
        "mark": {"shape": "cross", "size": size, "width": size * _ARM, "polarity": polarity},
        "marks": [{"x": float(x), "y": float(y)} for x, y in mark_places_mm(twin)],
    }


def truth(twin: Twin) -> dict[str, Any]:
    """Return N_i and the lens of each camera for truth.json; an ideal lens has one coefficient of 0."""
    lenses = [p.lens for p in twin.pinholes]
    return {
        "camera_matrices": [p.plane().tolist() for p in twin.pinholes],
        "distortion": [
            {"center": list(e.center_px), "radius": e.radius_px, "radial": list(e.radial) or [0.0]} for e in lenses
        ],
    }


def frames(twin: Twin) -> list[tuple[int, int, Any]]:
    """Return one frame per camera of the calibration board, as (camera, row 0, pixels)."""
    scene, light, array = _scene(twin), LightSection(), twin.scenario.array
    paint, result = LitTextures(scene.artwork, light), []
    for i, pinhole in enumerate(twin.pinholes):
        samples = scene.view(pinhole, np.eye(3), paint=paint, light=light, placements={})
        image = expose(
            samples,
            array,
            motion_px=np.zeros(2),
            brightness=array.gain * array.exposure_us(i) / array.reference_exposure_us,
            shade=vignette(array, i),
            noise=generator(array.seed, 7007, i),
        )
        result.append((i, 0, image))
    return result


def write_calibration_recording(twin: Twin, directory: Path, *, with_truth: bool = True) -> Recording:
    """Write a recording of the calibration board with `layout.json` and, if `with_truth`, `truth.json`."""
    head = RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=twin.heads,
        rows=1,
        trigger_period_s=twin.line.trigger_period_s,
        conveyor_mm_s=(0.0, 0.0),
    )
    write_json(directory / "layout.json", layout(twin))
    if with_truth:
        write_json(directory / "truth.json", truth(twin))
    return write_recording(directory, head, frames(twin))


def _scene(twin: Twin) -> Scene:
    """Return the calibration board as a scene, rendered with the identity as its pose."""
    array, board = twin.scenario.array, twin.scenario.calibration_board
    last = array.cameras - 1
    (w, _), (w_last, _) = array.camera_view_mm(0), array.camera_view_mm(last)
    h = max(array.camera_view_mm(i)[1] for i in range(array.cameras))
    corner = (-w / 2 - _BORDER_MM, -h / 2 - _BORDER_MM)
    size = (array.center_mm(last) + (w + w_last) / 2 + 2 * _BORDER_MM, h + 2 * _BORDER_MM)
    canvas = Canvas.blank(corner, size, TEXTURE_PER_PIXEL * array.finest_px_per_mm, board.board_grey)
    for x, y in mark_places_mm(twin):
        canvas.cross((x, y), board.mark_mm, board.mark_mm * _ARM, board.mark_grey)
    surface, metal = to_bytes(canvas.grey), to_bytes(canvas.metal)
    artwork = Artwork((), (), surface, metal, canvas.px_per_mm, canvas.origin_mm)
    return Scene(BoardSection(fiducials=()), artwork, twin.scenario.belt.grey)
