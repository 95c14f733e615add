"""Tests of the ring's file: owner and leftovers, allocation, and refusal of foreign files."""

from __future__ import annotations

import multiprocessing
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.ring import (
    HEADER,
    PAGE_BYTES,
    FrameShape,
    Ring,
    RingLayout,
    create_file,
    open_existing,
    read_owner,
    remove_leftovers,
    start_ticks,
)
from vaoi_station.errors import BusyError, InputError, NotFoundError, StateError

LAYOUT = RingLayout(3, 2, (FrameShape(40, 30, "Mono8"), FrameShape(64, 20, "Mono16")))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "vaoi-test.ring"


@pytest.fixture(scope="module")
def content_of_leftover(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the content of a ring whose owner has ended without unlinking it."""
    path = tmp_path_factory.mktemp("leftover") / "vaoi-test.ring"
    child = multiprocessing.get_context("spawn").Process(target=create_and_die, args=(path,))
    child.start()
    child.join()
    return path.read_bytes()


@pytest.fixture
def leftover(path: Path, content_of_leftover: bytes) -> Path:
    path.write_bytes(content_of_leftover)
    return path


def create_and_die(path: Path) -> None:
    Ring.create(path, LAYOUT)
    os._exit(0)


def test_the_file_has_the_mode_and_the_size_of_its_layout(path: Path) -> None:
    with Ring.create(path, LAYOUT):
        assert path.stat().st_mode & 0o777 == 0o640
        assert path.stat().st_size == LAYOUT.file_bytes
        assert path.stat().st_blocks * 512 >= LAYOUT.file_bytes, "allocated, not sparse"


def test_only_leftovers_of_dead_owners_are_removed(leftover: Path) -> None:
    path = leftover
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


def test_a_reused_pid_does_not_keep_a_leftover_alive(leftover: Path) -> None:
    path = leftover
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
from vaoi_station.acquisition.ring import Ring, RingLayout
from vaoi_station.acquisition.ring import FrameShape
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
        with pytest.raises(InputError, match="but its header states"):
            Ring.attach(copy)
        content[8] = 99
        copy.write_bytes(content)
        with pytest.raises(InputError, match="layout_version is 99"):
            Ring.attach(copy)


@pytest.mark.parametrize(("field", "value"), [("cameras", 0xFFFFFFFF), ("camera_table", 1 << 63), ("camera_table", 1)])
def test_a_header_that_contradicts_its_file_is_refused(path: Path, field: str, value: int) -> None:
    with Ring.create(path, LAYOUT):
        copy = path.with_name("copy.ring")
        page = np.frombuffer(path.read_bytes()[:PAGE_BYTES], dtype=HEADER).copy()
        page[field] = value
        copy.write_bytes(page.tobytes() + path.read_bytes()[PAGE_BYTES:])
        with pytest.raises(InputError):
            Ring.attach(copy)


def test_a_memory_limit_is_noted_and_not_fatal(path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, hard))
    try:
        with Ring.create(path, LAYOUT) as ring:
            assert ring.lock_note == "" or "LimitMEMLOCK" in ring.lock_note
    finally:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (soft, hard))


def test_the_start_time_identifies_a_running_process() -> None:
    own = start_ticks(os.getpid())
    assert own is not None
    assert own == start_ticks(os.getpid())
    assert start_ticks(1) != own or os.getpid() == 1


def test_a_process_that_has_ended_has_no_start_time() -> None:
    """A process that has not been waited for is a zombie, which counts as ended."""
    child = os.posix_spawn("/bin/true", ["true"], {})
    os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
    assert start_ticks(child) is None
    os.waitpid(child, 0)
    assert start_ticks(child) is None


def test_the_owner_is_read_from_the_file(path: Path) -> None:
    assert read_owner(path) is None
    with Ring.create(path, LAYOUT):
        assert read_owner(path) == (os.getpid(), True)


def test_the_owner_of_a_leftover_does_not_live(leftover: Path) -> None:
    owner = read_owner(leftover)
    assert owner is not None
    assert not owner[1]
    assert owner[0] != os.getpid()


def test_what_other_users_put_beside_the_ring_neither_blocks_nor_breaks_the_start(
    tmp_path: Path,
) -> None:
    os.mkfifo(tmp_path / "a.ring")
    (tmp_path / "b.ring").symlink_to("b.ring")
    (tmp_path / "c.ring").symlink_to("/dev/zero")
    (tmp_path / "d.ring").mkdir()
    (tmp_path / "e.ring").write_bytes(b"")
    before = sorted(tmp_path.iterdir())
    assert remove_leftovers(tmp_path) == []
    assert sorted(tmp_path.iterdir()) == before
    for name in "abcde":
        path = tmp_path / f"{name}.ring"
        assert read_owner(path) is None
        with pytest.raises(StateError, match="belongs to another program") as refusal:
            create_file(path, LAYOUT)
        assert refusal.value.code == "ring-taken"
        if name != "e":
            with pytest.raises(InputError, match=r"is not a ring|cannot be opened"):
                open_existing(path, writable=False)
