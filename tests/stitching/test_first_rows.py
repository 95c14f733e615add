"""The adjustment begins while the last row is awaited: the result is the same as if it had not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching import conclude
from vaoi_station.stitching.adjustment import solver as adjustment
from vaoi_station.stitching.matching.evidence import Evidence
from vaoi_station.stitching.work import TaskRunner, all_tasks


def last_row(evidence: Evidence) -> int:
    return (evidence.task.b or evidence.task.a)[1]


def digits(stitch: Any) -> dict[str, Any]:
    document: dict[str, Any] = stitch.model_dump(mode="json")
    return document | {"quality": {k: v for k, v in document["quality"].items() if k != "timings_ms"}}


def corners(stitch: Any) -> list[Any]:
    """Return where the images show two corners of the board's extent, px."""
    cad = np.array([[0.0, 0.0, 1.0], [40.0, 30.0, 1.0]]).T
    images = [m @ stitch.cad_matrix @ cad for of_camera in stitch.image_matrices for m in of_camera]
    return [at[:2] / at[2] for at in images]


@pytest.fixture(autouse=True)
def few_links_suffice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the adjustment of a small board begin early, too."""
    monkeypatch.setattr(conclude, "LEAST_BEGUN", 100)


@pytest.fixture(scope="module")
def evidence(filmed: Any) -> list[Evidence]:
    runner = TaskRunner(filmed.setup, filmed.frame)
    return [runner.perform(task) for task in all_tasks(filmed.present, dict(enumerate(filmed.times_s)), filmed.setup)]


@pytest.mark.parametrize("arrived", ["all rows but the last", "all rows", "half of the rows"])
def test_what_was_adjusted_early_changes_no_digit(
    filmed: Any, evidence: list[Evidence], arrived: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    last = len(filmed.times_s) - 1
    first = {"all rows but the last": last - 1, "all rows": last, "half of the rows": last // 2}[arrived]
    late = TaskRunner(filmed.setup, filmed.frame).conclude(filmed.times_s, filmed.present, evidence)
    early = TaskRunner(filmed.setup, filmed.frame)
    for row in range(first + 1):
        for one in (e for e in evidence if last_row(e) == row):
            early.add_evidence(one)
        while early.prepare():
            pass
    if first >= last - 1:
        monkeypatch.setattr(TaskRunner, "_begin", lambda *_: pytest.fail("it was begun before"))
    assert digits(early.conclude(filmed.times_s, filmed.present, evidence)) == digits(late)


def test_beginning_with_the_first_rows_ends_where_all_rows_lead(
    filmed: Any, evidence: list[Evidence], monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[int] = []
    step = adjustment._Solver.step

    def counted(self: Any) -> float:
        steps.append(self.rows)
        return step(self)

    monkeypatch.setattr(adjustment._Solver, "step", counted)
    begun = TaskRunner(filmed.setup, filmed.frame).conclude(filmed.times_s, filmed.present, evidence)
    with_all = steps.count(len(filmed.times_s))
    monkeypatch.setattr(TaskRunner, "_first_rows", lambda *_: None)
    steps.clear()
    anew = TaskRunner(filmed.setup, filmed.frame).conclude(filmed.times_s, filmed.present, evidence)
    assert with_all <= 3 < len(steps)
    for a, b in zip(corners(begun), corners(anew), strict=True):
        assert a == pytest.approx(b, abs=2e-3)


def test_a_frame_that_is_missing_is_waited_for_until_the_end(filmed: Any, evidence: list[Evidence]) -> None:
    """Which frames are missing is known at the end: the run is then adjusted at once, early or not."""
    lost = (0, 2)
    found = [e for e in evidence if lost not in (e.task.a, e.task.b)]
    present = [key for key in filmed.present if key != lost]
    tasks = set(all_tasks(present, dict(enumerate(filmed.times_s)), filmed.setup))
    found += [TaskRunner(filmed.setup, filmed.frame).perform(task) for task in tasks - {e.task for e in found}]
    late = TaskRunner(filmed.setup, filmed.frame).conclude(filmed.times_s, present, found)
    early = TaskRunner(filmed.setup, filmed.frame)
    for one in found:
        early.add_evidence(one)
        while early.prepare():
            pass
    assert digits(early.conclude(filmed.times_s, present, found)) == digits(late)
