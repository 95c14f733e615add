"""Marks of consecutive rows are linked where the belt identifies them without doubt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.mark_links import mark_links
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.matching.evidence import Detections, Task

NOMINAL = nominal_motion(np.array([0.0, 0.1, 0.2]), np.array([0.0, 50.0]), np.zeros(2))
STEP_PX = 50.0
MARKS = np.array([[30.0, 20.0], [90.0, 25.0], [150.0, 22.0]])


def detections(camera: int, row: int, px: NDArray[np.float64], kind: list[int] | None = None) -> Detections:
    k = len(px)
    kinds = np.array(kind if kind is not None else [0] * k, dtype=np.int_)
    return Detections(Task("marks", (camera, row)), px, np.full(k, 0.02), np.full(k, 0.9), kinds)


def test_a_mark_is_linked_to_where_the_belt_carried_it(workshop: Any) -> None:
    moved = MARKS[::-1] + (3.0, STEP_PX - 4.0)
    (links,) = mark_links([detections(0, 0, MARKS), detections(0, 1, moved)], (workshop.camera(),), NOMINAL)
    assert links.task == Task("rows", (0, 0), (0, 1))
    assert links.a_px.tolist() == MARKS.tolist()
    assert links.b_px == pytest.approx(MARKS + (3.0, STEP_PX - 4.0))
    assert links.information[0] == pytest.approx(np.eye(2) / (2 * 0.02**2))


def test_an_ambiguous_mark_is_not_linked(workshop: Any) -> None:
    camera = (workshop.camera(),)
    twice = np.concatenate([MARKS, MARKS[:1] + 2.0])
    for a, b in ((MARKS, twice + (0, STEP_PX)), (twice, MARKS + (0, STEP_PX))):
        (links,) = mark_links([detections(0, 0, a), detections(0, 1, b)], camera, NOMINAL)
        assert sorted(links.a_px[:, 0]) == [90.0, 150.0]


def test_marks_of_another_kind_or_too_far_away_are_not_linked(workshop: Any) -> None:
    camera = (workshop.camera(),)
    carried = MARKS + (0, STEP_PX)
    for other in (detections(0, 1, carried, [1, 1, 1]), detections(0, 1, carried + (0, 20.0))):
        (links,) = mark_links([detections(0, 0, MARKS), other], camera, NOMINAL)
        assert (len(links.a_px), links.note) == (0, "no mark is in both rows")


def test_rows_without_marks_are_skipped_and_cameras_are_separate(workshop: Any) -> None:
    cameras = (workshop.camera((0, 0)), workshop.camera((15, 0)))
    none = np.zeros((0, 2))
    seen = [detections(0, 2, MARKS + (0, 2 * STEP_PX)), detections(0, 1, none), detections(0, 0, MARKS)]
    links = mark_links([*seen, detections(1, 1, MARKS)], cameras, NOMINAL)
    assert [(e.task.a, e.task.b) for e in links] == [((0, 0), (0, 2))]
    assert len(links[0].a_px) == 3
