"""Conclusions of a simulated board: their stages, their provenance, and what is left without a board type."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry.robust import Failure
from vaoi_station.model import Status, Stitch
from vaoi_station.stitching.conclude import NO_BOARD_TYPE, StageTimes, sort_evidence
from vaoi_station.stitching.matching.evidence import Detections, Evidence, Links, Task
from vaoi_station.stitching.work import TaskRunner, all_tasks


def test_times_of_stages_add_up_to_the_whole() -> None:
    before = time.perf_counter()
    stages = StageTimes()
    for name in ("first", "second", "third"):
        sum(range(20_000))
        stages.finish(name)
    whole_ms = (time.perf_counter() - before) * 1e3
    assert list(stages.ms) == ["first", "second", "third"]
    assert all(ms > 0 for ms in stages.ms.values())
    assert sum(stages.ms.values()) == pytest.approx(whole_ms, rel=0.5, abs=5)
    assert sum(stages.ms.values()) <= whole_ms + 0.01


def test_image_matrices_are_camera_matrix_times_row_motion(filmed: Any) -> None:
    stitch = filmed.stitch
    for camera, matrices in zip(stitch.cameras(filmed.setup.cameras), stitch.image_matrices, strict=True):
        for motion, matrix in zip(stitch.row_motion, matrices, strict=True):
            np.testing.assert_allclose(matrix, camera.image_from_row.matrix @ motion, rtol=1e-12)


def test_matrices_are_read_only(filmed: Any) -> None:
    stitch = filmed.stitch
    for matrix in (stitch.cad_matrix, stitch.row_motion[1], stitch.image_matrices[0][1]):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 1.0


def test_the_document_that_skipped_validation_is_valid(filmed: Any) -> None:
    document = filmed.stitch.model_dump(mode="json")
    assert Stitch.model_validate(document).model_dump(mode="json") == document


def test_every_component_has_the_views_of_the_truth(filmed: Any) -> None:
    stitch = filmed.stitch
    assert set(stitch.components) == set(filmed.truth["views"])
    assert filmed.error_px(stitch) < 0.5


def test_a_row_that_nothing_places_has_no_matrices(filmed: Any) -> None:
    """Without the frames around it the last row is linked to no other."""
    last = max(j for _, j in filmed.present)
    frames = {key: pixels for key, pixels in filmed.frames.items() if not last - 4 < key[1] < last}
    stitch = filmed.stitched(frames=frames)
    assert {len(row) for row in stitch.image_matrices} == {last + 1}
    there = [m is not None for m in stitch.image_matrices[0]]
    assert there[: last - 4] == [True] * (last - 4)


def evidence_of(task: Task) -> Evidence:
    if task.kind == "marks":
        none = np.zeros(0)
        return Detections(task, np.zeros((0, 2)), none, none, none.astype(np.int_))
    return Links.empty(task, "none")


EVIDENCE = [
    evidence_of(task)
    for task in (
        Task("rows", (0, 0), (0, 1), 0.1),
        Task("rows", (0, 0), (0, 2), 0.2),
        Task("neighbours", (0, 0), (1, 0)),
        Task("marks", (0, 0)),
        Task("marks", (1, 1)),
        Task("reference", (0, 1), (0, 3)),
    )
]


@given(st.permutations(EVIDENCE))
def test_evidence_in_any_order_is_sorted_into_its_kinds(evidence: list[Evidence]) -> None:
    found = sort_evidence(evidence)
    assert [e.task.b for e in found.links] == [(0, 1), (0, 2), (1, 0)]
    assert [e.task.kind for e in found.reference_links] == ["reference"]
    assert [e.task.a for e in found.detections] == [(0, 0), (1, 1)]


def test_a_result_states_its_software_and_the_times_of_its_stages(filmed: Any) -> None:
    quality = filmed.stitch.quality
    assert list(quality["timings_ms"]) == ["motion", "cad", "verdict"]
    assert all(ms >= 0 for ms in quality["timings_ms"].values())
    assert quality["software"].startswith("vaoi_station ")
    assert "reference" not in quality, "none was used"


@pytest.fixture(scope="module")
def without_board_type(filmed: Any) -> Any:
    setup = replace(filmed.setup, board_type=None)
    runner = TaskRunner(setup, filmed.frame)
    tasks = all_tasks(filmed.present, dict(enumerate(filmed.times_s)), setup)
    return runner.conclude_with_findings(filmed.times_s, filmed.present, [runner.perform(t) for t in tasks])


def test_without_a_board_type_there_are_image_matrices_and_a_reason(filmed: Any, without_board_type: Any) -> None:
    stitch, findings = without_board_type
    assert stitch.status == Status.FAILED
    assert NO_BOARD_TYPE.reason in stitch.reasons
    assert stitch.cad_matrix is None
    assert stitch.components is None
    assert isinstance(findings.found, Failure)
    assert findings.found is NO_BOARD_TYPE
    assert all(m is not None for row in stitch.image_matrices for m in row)


def test_without_a_board_type_the_motion_of_the_rows_converges_as_well(filmed: Any, without_board_type: Any) -> None:
    stitch, _ = without_board_type
    for ours, true in zip(stitch.row_motion, filmed.truth["row_motion"], strict=True):
        assert np.hypot(*(ours[:2, 2] - np.asarray(true)[:2, 2])) < 0.05
