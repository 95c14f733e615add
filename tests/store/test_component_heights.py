"""Heights are stored once per run, and deleted with its result."""

from __future__ import annotations

import pytest

from tests.store.conftest import MakeRun, noise
from vaoi_station.store import Store


@pytest.mark.parametrize("document", ["{}", noise(4000)])
def test_heights_are_kept_as_they_are_first_written(store: Store, make_run: MakeRun, document: str) -> None:
    store.save_run(make_run("r1", "ready", 1))
    store.heights.save("r1", document).result(10)
    store.heights.save("r1", "other").result(10)
    assert store.heights.document("r1") == document
    assert store.heights.document("r2") is None


def test_heights_are_deleted_with_the_result_and_do_not_come_back(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1", "ready", 1))
    store.heights.save("r1", "{}").result(10)
    store.retention.forget_details(["r1"]).result(10)
    assert store.heights.document("r1") is None
    store.heights.save("r1", "{}").result(10)
    assert store.heights.document("r1") is None
    store.retention.forget_runs(["r1"]).result(10)
    assert store.run("r1") is None


def test_heights_of_a_run_that_has_not_ended_are_not_written(store: Store, make_run: MakeRun) -> None:
    store.save_run(make_run("r1"))
    store.heights.save("r1", "{}").result(10)
    assert store.heights.document("r1") is None
