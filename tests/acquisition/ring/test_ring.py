"""Tests of the ring: owner, borrowers, generations and the slot table."""

from __future__ import annotations

import multiprocessing
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.ring.ring import Ring, remove_leftovers, ring_path
from vaoi_station.acquisition.ring.ring_layout import EMPTY, HEADER, NO_ROW, OK, FrameShape, RingLayout
from vaoi_station.config import StationConfig
from vaoi_station.errors import BusyError, GoneError, InputError, NotFoundError, StateError

LAYOUT = RingLayout(3, 2, (FrameShape(40, 30, "Mono8"), FrameShape(64, 20, "Mono16")))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "vaoi-test.ring"


def read_frame(path: Path, slot: int, answer: Connection) -> None:
    """Send what another process reads from the ring."""
    with Ring.attach(path) as ring:
        answer.send((ring.frame(slot).copy(), ring.frame(slot).flags.writeable, ring.generation(0)))


def create_and_die(path: Path) -> None:
    Ring.create(path, LAYOUT)
    os._exit(0)


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


def test_the_file_has_the_mode_and_the_size_of_its_layout(path: Path) -> None:
    with Ring.create(path, LAYOUT):
        assert path.stat().st_mode & 0o777 == 0o640
        assert path.stat().st_size == LAYOUT.file_bytes
        assert path.stat().st_blocks * 512 >= LAYOUT.file_bytes, "allocated, not sparse"


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


def test_only_leftovers_of_dead_owners_are_removed(path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(target=create_and_die, args=(path,))
    child.start()
    child.join()
    assert path.exists()
    foreign = path.with_name("foreign.ring")
    foreign.write_bytes(b"x" * 5000)
    short = path.with_name("short.ring")
    short.write_bytes(b"VAOIRING")
    with Ring.create(path.with_name("living.ring"), LAYOUT) as living:
        assert not path.exists(), "creating a ring removes leftovers from its directory"
        assert remove_leftovers(path.parent) == []
        assert living.path.exists()
    assert foreign.exists()
    assert short.exists()


def test_a_reused_pid_does_not_keep_a_leftover_alive(path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(target=create_and_die, args=(path,))
    child.start()
    child.join()
    with path.open("r+b") as file:  # as if the number had been given to this very process
        file.seek(HEADER.fields["owner_pid"][1])  # type: ignore[index]
        file.write(np.uint32(os.getpid()).tobytes())
    assert remove_leftovers(path.parent) == [path]


def test_a_locked_ring_is_alive_whatever_its_pid_says(path: Path) -> None:
    with Ring.create(path, LAYOUT) as ring:
        with path.open("r+b") as file:  # as seen from a container that shares the memory but not the pids
            file.seek(HEADER.fields["owner_pid"][1])  # type: ignore[index]
            file.write(np.uint32(2**22 + 1).tobytes())
        assert remove_leftovers(path.parent) == []
        assert ring.path.exists()


@pytest.mark.parametrize("bays", [10**9, 10**14], ids=["more than memory", "more than a file may have"])
def test_a_ring_too_large_is_refused_with_its_size_and_leaves_nothing(path: Path, bays: int) -> None:
    with pytest.raises(BusyError, match=r"needs .* MiB") as caught:
        Ring.create(path, RingLayout(bays, 2, LAYOUT.frames))
    assert "runs" in caught.value.action
    assert not path.exists()


def test_memory_that_runs_out_while_allocating_is_an_error_and_leaves_nothing(path: Path) -> None:
    """A limit of the process on file sizes stands in for a full tmpfs."""
    script = """
import pathlib, resource, sys
from vaoi_station.acquisition.ring.ring import Ring, RingLayout
from vaoi_station.acquisition.ring.ring_layout import FrameShape
from vaoi_station.errors import BusyError
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, resource.RLIM_INFINITY))
try:
    Ring.create(pathlib.Path(sys.argv[1]), RingLayout(3, 2, (FrameShape(400, 300, "Mono8"),)))
except BusyError as error:
    print(error)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", script, str(path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert "File too large" in done.stdout
    assert not path.exists()


def test_an_absent_directory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be created"):
        Ring.create(tmp_path / "absent" / "x.ring", LAYOUT)


def test_attaching_to_nothing_or_to_something_else_is_refused(path: Path) -> None:
    with pytest.raises(NotFoundError):
        Ring.attach(path)
    path.write_bytes(b"not a ring")
    with pytest.raises(InputError, match="is not a ring"):
        Ring.attach(path)


def test_another_layout_version_or_size_is_refused(path: Path) -> None:
    with Ring.create(path, LAYOUT):
        copy = path.with_name("copy.ring")
        content = bytearray(path.read_bytes())
        copy.write_bytes(content[:-1])
        with pytest.raises(InputError, match="its header says"):
            Ring.attach(copy)
        content[8] = 99
        copy.write_bytes(content)
        with pytest.raises(InputError, match="layout_version is 99"):
            Ring.attach(copy)


def test_a_memory_limit_is_noted_and_not_fatal(path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, hard))
    try:
        with Ring.create(path, LAYOUT) as ring:
            assert ring.lock_note == "" or "LimitMEMLOCK" in ring.lock_note
    finally:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (soft, hard))


def test_a_station_gets_the_ring_its_configuration_asks_for(make_config: Callable[..., StationConfig]) -> None:
    config = make_config()
    layout = RingLayout.of(config)
    assert (layout.bays, layout.cameras, layout.slots_per_camera) == (config.ring.runs, 2, config.rows_per_run)
    assert layout.frames[0] == FrameShape(96, 72, "Mono8")
    assert ring_path(config).name == "vaoi-test.ring"
