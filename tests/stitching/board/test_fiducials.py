"""Detection of fiducials in frames of the twin, against the truth."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.fiducials import (
    detect_marks,
    detect_more_marks,
    relocate_fiducials,
)
from vaoi_station.stitching.matching.evidence import Detections, Task
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene


def true_places(filmed: Any) -> dict[tuple[int, int], dict[int, Any]]:
    """Where the twin's fiducials are in every frame that shows all of them."""
    out: dict[tuple[int, int], dict[int, Any]] = {}
    fiducials = np.array([(f.x, f.y) for f in filmed.board_type.fiducials])
    for i, j in filmed.present:
        px = apply(np.array(filmed.truth["image_matrices"][i][j]) @ filmed.truth["cad_matrix"], fiducials)
        inside = np.flatnonzero(filmed.setup.cameras[i].sees(px, 30))
        out[i, j] = {int(n): px[n] for n in inside}
    return out


def test_fiducials_displaced_by_look_alikes_are_located_again(filmed: Any) -> None:
    motion = truth_motion(filmed)
    prepared = {key: PreparedFrame(pixels) for key, pixels in filmed.frames.items()}
    scene = Scene(filmed.setup.cameras, tuple(filmed.present), prepared.__getitem__)
    none = np.zeros(0)
    nothing = [Detections(Task("marks", k), np.zeros((0, 2)), none, none, none.astype(int)) for k in filmed.present]
    marks = np.array([(f.x, f.y) for f in filmed.board_type.fiducials])
    places = apply(np.array(filmed.truth["cad_matrix"]), marks)
    again = relocate_fiducials(filmed.board_type, places, scene, motion, nothing)
    assert [s.task for s in again] == [s.task for s in nothing]
    for s in again:
        for place in true_places(filmed)[s.task.a].values():
            assert np.hypot(*(s.px - place).T).min() < 0.1
    twice = relocate_fiducials(filmed.board_type, places, scene, motion, again)
    assert [len(s.px) for s in twice] == [len(s.px) for s in again], "a known detection is not listed twice"
    deep = detect_more_marks(filmed.board_type, scene, nothing, fixture=False)
    assert sum(len(s.px) for s in deep) >= sum(len(s.px) for s in again)


def truth_motion(filmed: Any) -> Motion:
    d = np.array(filmed.truth["row_motion"])
    back = np.linalg.inv(d)
    return Motion(np.arctan2(back[:, 1, 0], back[:, 0, 0]), back[:, :2, 2], np.zeros(2))


def dots(workshop: Any, places: list[tuple[float, float]], radius_px: float) -> PreparedFrame:
    """Draw bright discs on a dark frame."""
    picture = np.full((160, 200), 40, dtype=np.uint8)
    for x, y in places:
        cv2.circle(picture, (round(16 * x), round(16 * y)), round(16 * radius_px), 210, -1, cv2.LINE_AA, 4)
    return PreparedFrame(cv2.GaussianBlur(picture, (0, 0), 0.7))


def test_discs_are_detected_to_some_hundredths_of_a_pixel(workshop: Any) -> None:
    places = [(40.25, 50.5), (120.0, 31.75), (160.5, 120.25)]
    kind = BoardType.model_validate({"name": "b", "fiducials": [{"name": "A", "x": 0, "y": 0, "diameter": 1.6}]})
    found = detect_marks(Task("marks", (0, 0)), dots(workshop, places, 8.0), workshop.camera(), kind)
    assert (found.kind == 0).all()
    for place in places:
        off = np.hypot(*(found.px - place).T)
        assert off.min() < 0.1
        assert found.score[off.argmin()] > 0.9
