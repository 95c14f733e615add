"""Preparation of a run's evidence: which links and detections remain, and which camera each belongs to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from vaoi_station.drift.evidence import RunEvidence, prepare_evidence, subsample_links
from vaoi_station.model import Stitch
from vaoi_station.simulation import Twin
from vaoi_station.stitching.matching.evidence import Detections, Evidence, Links, Task
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks


@dataclass(frozen=True)
class Run:
    """A stitched board of the twin."""

    setup: StitchSetup
    times_s: np.ndarray
    evidence: tuple[Evidence, ...]
    stitch: Stitch

    def prepared(self, **options: object) -> RunEvidence:
        """Its evidence, perhaps without the board type or the C."""
        board_type = options.get("board_type", self.setup.board_type)
        stitch = self.stitch if options.get("with_c", True) else self.stitch.model_copy(update={"cad_matrix": None})
        assert board_type is None or board_type is self.setup.board_type
        evidence = options.get("evidence", self.evidence)
        assert isinstance(evidence, tuple)
        return prepare_evidence(
            self.setup.cameras,
            self.setup.board_type if board_type is not None else None,
            self.times_s,
            self.setup.conveyor_mm_s,
            evidence,
            stitch,
        )


@pytest.fixture(scope="module")
def run(knocked_twin: Callable[..., Twin]) -> Run:
    twin = knocked_twin()
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    times_s, present = head.row_times_s(), sorted(frames)
    runner = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    evidence = tuple(runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup))
    return Run(setup, times_s, evidence, runner.conclude(times_s, present, evidence))


def links(task: Task, k: int) -> Links:
    px = np.arange(2.0 * k).reshape(k, 2)
    return Links(task, px, px + 1, np.tile(np.eye(2), (k, 1, 1)), np.arange(k) / k)


def test_long_lists_of_links_from_row_to_row_are_thinned_evenly() -> None:
    whole = links(Task("rows", (0, 0), (0, 1), 0.1), 240)
    few = subsample_links(whole)
    assert isinstance(few, Links)
    assert len(few.a_px) == len(few.b_px) == len(few.information) == len(few.score) == 24
    assert few.a_px[0].tolist() == whole.a_px[0].tolist()
    assert few.a_px[-1].tolist() == whole.a_px[-1].tolist()
    assert np.diff(few.a_px[:, 0]).std() < 2


def test_other_evidence_is_not_thinned() -> None:
    short = links(Task("rows", (0, 0), (0, 1), 0.1), 24)
    seam = links(Task("neighbours", (0, 0), (1, 0)), 90)
    none = np.zeros(0)
    marks = Detections(Task("marks", (0, 0)), np.zeros((0, 2)), none, none, none.astype(np.int_))
    for e in (short, seam, marks):
        assert subsample_links(e) is e


def test_links_on_components_are_left_out(run: Run) -> None:
    with_c, without = run.prepared(), run.prepared(with_c=False)
    assert 0 < len(with_c.links) < len(without.links)
    assert len(run.prepared(board_type=None).links) == len(without.links)


def test_pixels_are_those_of_the_links_and_of_their_cameras(run: Run) -> None:
    found = run.prepared()
    assert len(found.a_px) == len(found.b_px) == len(found.camera_a) == len(found.camera_b) == len(found.links)
    for i, camera in enumerate(found.cameras):
        mine = found.camera_a == i
        np.testing.assert_allclose(camera.row_from_image(found.a_px[mine]), found.links.a_mm[mine], atol=1e-9)
        mine = found.camera_b == i
        np.testing.assert_allclose(camera.row_from_image(found.b_px[mine]), found.links.b_mm[mine], atol=1e-9)


def test_detections_become_fiducials_only_under_c(run: Run) -> None:
    found = run.prepared()
    assert found.fiducials is not None
    assert len(found.fiducials.row) == len(found.camera_f) == len(found.f_px) >= 3
    assert found.similarity is not None
    for i, px, ground in zip(found.camera_f, found.f_px, found.fiducials.ground_mm, strict=True):
        assert found.cameras[i].row_from_image(px) == pytest.approx(ground, abs=1e-6)
    blind = run.prepared(with_c=False)
    assert (blind.fiducials, blind.similarity, len(blind.camera_f)) == (None, None, 0)
    assert blind.surface.at_links.shape == (len(blind.links), 1), "one common height"


def test_the_order_of_the_evidence_does_not_matter(run: Run) -> None:
    one, other = run.prepared(), run.prepared(evidence=run.evidence[::-1])
    assert np.array_equal(one.a_px, other.a_px)
    assert np.array_equal(one.f_px, other.f_px)
    assert np.array_equal(one.motion.shift, other.motion.shift)
