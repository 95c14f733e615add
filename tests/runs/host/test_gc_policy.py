"""Full garbage collections wait until no board is processed."""

from __future__ import annotations

import gc
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.runs.host import gc_policy as module
from vaoi_station.runs.host.gc_policy import IDLE_S, LONGEST_S, GcPolicy, no_collections


class Knot:
    """An object that refers to itself, so that only the collector frees it."""

    def __init__(self) -> None:
        self.itself = self


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def policy(clock: Clock) -> Iterator[GcPolicy]:
    policy = GcPolicy(clock)
    policy.start()
    yield policy
    policy.stop()


@pytest.fixture
def _nothing_frozen() -> Iterator[None]:
    """Undo for one test that the session's objects are excluded (tests/conftest.py)."""
    gc.unfreeze()
    yield
    gc.collect()
    gc.freeze()


def old_knot() -> weakref.ref[Knot]:
    """Garbage of the oldest generation, which only a full collection finds."""
    knot = Knot()
    gc.collect(1)
    gc.collect(1)
    return weakref.ref(knot)


def test_a_full_collection_waits_until_no_board_is_processed(policy: GcPolicy, clock: Clock) -> None:
    knot = old_knot()
    clock.now_s += IDLE_S
    policy.tick(busy=True)
    assert knot() is not None
    policy.tick(busy=False)
    assert knot() is None


def test_a_line_without_pauses_is_collected_after_the_longest_time(policy: GcPolicy, clock: Clock) -> None:
    knot = old_knot()
    clock.now_s += LONGEST_S
    policy.tick(busy=True)
    assert knot() is None


def test_the_interpreter_runs_no_full_collection(policy: GcPolicy) -> None:
    collections = gc.get_stats()[2]["collections"]
    kept = [[k] for k in range(400_000)]
    assert gc.get_stats()[2]["collections"] == collections
    assert len(kept) == 400_000


def test_free_memory_goes_back_once_a_minute(policy: GcPolicy, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    returned: list[float] = []
    monkeypatch.setattr(module, "return_free_memory", lambda: returned.append(clock.now_s))
    begin_s = clock.now_s
    for _ in range(13):
        clock.now_s += IDLE_S
        policy.tick(busy=False)
    assert returned == [begin_s + LONGEST_S, begin_s + 2 * LONGEST_S]


def anonymous_bytes() -> int:
    text = Path("/proc/self/smaps_rollup").read_text()
    (line,) = (line for line in text.splitlines() if line.startswith("Anonymous:"))
    return int(line.split()[1]) * 1024


def test_pages_of_the_heap_of_a_thread_go_back() -> None:
    kept: list[bytearray] = []

    def fill() -> None:
        blocks = [bytearray(5000) for _ in range(10_000)]
        kept.append(blocks[-1])  # behind all others, so the heap's end cannot shrink

    thread = threading.Thread(target=fill)
    thread.start()
    thread.join()
    before = anonymous_bytes()
    module.return_free_memory()
    assert anonymous_bytes() < before - 25_000_000


@pytest.mark.usefixtures("_nothing_frozen")
def test_stopping_restores_the_settings() -> None:
    before = gc.get_threshold()
    policy = GcPolicy()
    policy.start()
    assert gc.get_freeze_count() > 0
    policy.stop()
    policy.tick(busy=False)
    assert gc.get_threshold() == before
    assert gc.get_freeze_count() == 0


@pytest.mark.usefixtures("_nothing_frozen")
def test_objects_that_the_program_has_excluded_stay_excluded() -> None:
    gc.freeze()
    frozen = gc.get_freeze_count()
    policy = GcPolicy()
    policy.start()
    kept = [[k] for k in range(1000)]
    policy.stop()
    assert 0 < gc.get_freeze_count() <= frozen
    assert len(kept) == 1000


@pytest.mark.parametrize("automatic", [False, True])
def test_nothing_is_collected_while_a_process_builds_its_parts(automatic: bool) -> None:
    (gc.enable if automatic else gc.disable)()
    try:
        with no_collections():
            during = gc.isenabled()
        assert (during, gc.isenabled()) == (False, automatic)
    finally:
        gc.enable()
