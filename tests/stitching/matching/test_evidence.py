"""The table of methods covers every name that the configuration accepts."""

from __future__ import annotations

import pickle
from dataclasses import asdict

import pytest

from vaoi_station.stitching.matching.evidence import METHODS, Links, Task


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


def test_auto_uses_all_evidence_and_every_other_method_less() -> None:
    evidence = {name: {kind for kind, used in asdict(method).items() if used} for name, method in METHODS.items()}
    everything = evidence.pop("auto")
    assert everything == {"links", "marks", "fixture", "reference"}
    assert all(used and used < everything for used in evidence.values())
    assert len({frozenset(used) for used in evidence.values()}) == len(evidence)
