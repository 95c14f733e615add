"""Tests of the ring: owner, borrowers, generations and the slot table."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.ring import EMPTY, NO_ROW, OK, FrameShape, Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import GoneError, StateError

LAYOUT = RingLayout(3, 2, (FrameShape(40, 30, "Mono8"), FrameShape(64, 20, "Mono16")))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "vaoi-test.ring"


def read_frame(path: Path, slot: int, answer: Connection) -> None:
    """Send what another process reads from the ring."""
    with Ring.attach(path) as ring:
        answer.send((ring.frame(slot).copy(), ring.frame(slot).flags.writeable, ring.generation(0)))


def test_another_process_reads_the_frames_of_the_owner(path: Path) -> None:
    with Ring.create(path, LAYOUT) as ring:
        generation = ring.claim(0)
        slot = ring.slot(0, 1, 1)
        ring.frame(slot)[:] = np.arange(64 * 20).reshape(20, 64)
        ours, theirs = multiprocessing.get_context("spawn").Pipe()
        reader = multiprocessing.get_context("spawn").Process(target=read_frame, args=(path, slot, theirs))
        reader.start()
        seen, writeable, seen_generation = ours.recv()
        reader.join()
        assert path.exists(), "a reader that exits does not unlink the file"
        assert seen.dtype == np.uint16
        assert (seen == ring.frame(slot)).all()
        assert (writeable, seen_generation) == (False, generation)
    assert not path.exists()


def test_a_claim_raises_the_generation_and_clears_only_its_bay(path: Path) -> None:
    with Ring.create(path, LAYOUT) as ring:
        for slot in range(LAYOUT.slots):
            ring.memory(slot)[:] = 7
        before = [ring.generation(b) for b in range(3)]
        generation = ring.claim(1)
        assert generation > max(before)
        assert [ring.generation(b) for b in (0, 2)] == [before[0], before[2]]
        black = {s for s in range(LAYOUT.slots) if not ring.memory(s).any()}
        assert black == {ring.slot(1, c, k) for c in range(2) for k in range(2)}
        assert ring.claim(2) > generation


def test_a_stale_generation_is_refused(path: Path) -> None:
    with Ring.create(path, LAYOUT) as ring, Ring.attach(path) as reader:
        old = ring.claim(0)
        assert reader.snapshot(0, old).shape == (30, 40)
        ring.claim(0)
        with pytest.raises(GoneError, match="later board"):
            reader.check_generation(0, old)
        with pytest.raises(GoneError):
            reader.snapshot(0, old)


def test_readers_cannot_write(path: Path) -> None:
    with Ring.create(path, LAYOUT), Ring.attach(path) as reader:
        with pytest.raises(ValueError, match="read-only"):
            reader.frame(0)[0, 0] = 1
        with pytest.raises(StateError, match="read-only"):
            reader.claim(0)


def test_a_borrower_leaves_the_file_and_sees_that_the_owner_closed_it(path: Path) -> None:
    ring = Ring.create(path, LAYOUT)
    with Ring.attach(path, writable=True) as borrower:
        borrower.frame(0)[:] = 9
    assert path.exists()
    assert (ring.frame(0) == 9).all()
    reader = Ring.attach(path)
    view = ring.frame(0)
    ring.close()
    ring.close()
    assert not path.exists()
    assert reader.closed_by_owner
    assert (view == 9).all(), "views outlive the ring they came from"
    reader.close()


def test_the_slot_table_describes_each_slot(path: Path) -> None:
    with Ring.create(path, LAYOUT) as ring:
        generation = ring.claim(0)
        assert ring.slot_record(1) == (generation, EMPTY, NO_ROW, 0)
        ring.write_slot_record(1, OK, 5, 65400)
        assert ring.slot_record(1) == (generation, OK, 5, 65400)
        ring.memory(1)[:] = 3
        ring.clear(1)
        assert not ring.memory(1).any()
        assert ring.slot_record(1) == (generation, EMPTY, NO_ROW, 0)


def test_two_stations_cannot_share_a_path(path: Path) -> None:
    with Ring.create(path, LAYOUT) as ring:
        with pytest.raises(StateError, match=f"process {os.getpid()}"):
            Ring.create(path, LAYOUT)
        assert path.exists()
        assert not ring.closed_by_owner


def test_a_station_gets_the_ring_its_configuration_asks_for(make_config: Callable[..., StationConfig]) -> None:
    config = make_config()
    layout = RingLayout.of(config)
    assert (layout.bays, layout.cameras, layout.slots_per_camera) == (config.ring.runs, 2, config.rows_per_run)
    assert layout.frames[0] == FrameShape(96, 72, "Mono8")
    assert ring_path(config).name == "vaoi-test.ring"
