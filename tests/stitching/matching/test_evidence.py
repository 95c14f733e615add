"""The table of methods covers every name that the configuration accepts."""

from __future__ import annotations

import pickle
from dataclasses import asdict
from typing import get_args

import numpy as np
import pytest

from vaoi_station.stitching.matching.evidence import METHODS, Detections, Links, MethodName, Task


@pytest.mark.parametrize("task", [Task("rows", (0, 0), (0, 1), 0.1), Task("neighbours", (0, 0), (1, 0))])
def test_empty_evidence_keeps_its_task_and_reason(task: Task) -> None:
    empty = Links.empty(task, "why", 12)
    assert (empty.task, empty.note, empty.tried, empty.unmatched) == (task, "why", 12, False)
    assert [len(v) for v in (empty.a_px, empty.b_px, empty.information, empty.score)] == [0] * 4
    assert empty.information.shape == (0, 2, 2)


def test_equal_tasks_are_the_same_key() -> None:
    task = Task("rows", (1, 4), (1, 5), 0.05)
    assert len({task, Task("rows", (1, 4), (1, 5), 0.05), pickle.loads(pickle.dumps(task))}) == 1
    others = {Task("neighbours", (1, 4), (1, 5), 0.05), Task("rows", (1, 4), (1, 6), 0.05), Task("marks", (1, 4))}
    assert task not in others


def test_two_pieces_of_evidence_are_equal_only_if_identical() -> None:
    """They are keys of the link store: their arrays must never be compared."""
    task = Task("rows", (0, 0), (0, 1), 0.1)
    first, second = Links.empty(task, ""), Links.empty(task, "")
    assert {first: 1}[first] == 1
    assert first != second
    assert len({first, second}) == 2


def test_detections_survive_pickling() -> None:
    px, sigma = np.array([[3.5, 4.0]]), np.array([0.02])
    sent = Detections(Task("marks", (2, 7)), px, sigma, np.array([0.9]), np.array([1]))
    received = pickle.loads(pickle.dumps(sent))
    assert received.task == sent.task
    assert (received.px == px).all()
    assert (received.sigma_px == sigma).all()
    assert received.kind.tolist() == [1]


def test_every_configured_name_but_that_of_the_paper_has_its_evidence() -> None:
    assert set(METHODS) <= set(get_args(MethodName))


def test_auto_uses_all_evidence_and_every_other_method_less() -> None:
    evidence = {name: {kind for kind, used in asdict(method).items() if used} for name, method in METHODS.items()}
    everything = evidence.pop("auto")
    assert everything == {"links", "marks", "fixture", "reference"}
    assert all(used and used < everything for used in evidence.values())
    assert len({frozenset(used) for used in evidence.values()}) == len(evidence)


def test_fixture_marks_are_detected_with_the_fiducials() -> None:
    assert all(method.marks for method in METHODS.values() if method.fixture)
