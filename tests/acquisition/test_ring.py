"""The ring: its layout, its file, its frames, and the programs of its document."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.needs import need
from vaoi_station.acquisition.ring import (
    HEADER,
    INCOMPLETE,
    OK,
    PAGE_BYTES,
    FrameShape,
    Ring,
    RingLayout,
    create_file,
    open_existing,
    read_owner,
    remove_leftovers,
)
from vaoi_station.errors import BusyError, GoneError, InputError, NotFoundError, StateError

shapes = st.builds(FrameShape, st.integers(16, 5000), st.integers(16, 5000), st.sampled_from(["Mono8", "Mono16"]))
layouts = st.builds(
    RingLayout,
    st.integers(1, 6),
    st.integers(1, 9),
    st.lists(shapes, min_size=1, max_size=5).map(tuple),
    st.sampled_from([0, PAGE_BYTES]),
)


@given(layouts)
def test_slots_lie_on_pages_of_their_own_inside_the_file(layout: RingLayout) -> None:
    offsets = [layout.offset(s) for s in range(layout.slots)]
    assert all(o % PAGE_BYTES == 0 for o in offsets)
    assert all(b - a == layout.slot_bytes for a, b in pairwise(offsets))
    assert all(f.nbytes + layout.room_bytes <= layout.slot_bytes for f in layout.frames)
    assert offsets[-1] + layout.slot_bytes == layout.file_bytes


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
        with pytest.raises(GoneError, match="later board") as refusal:
            reader.check_generation(0, old)
        assert refusal.value.code == "frames-gone"
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


EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


@pytest.mark.parametrize("language", ["c", "csharp"])
def test_programs_in_c_and_csharp_read_what_the_station_wrote(tmp_path: Path, language: str) -> None:
    binary = tmp_path / "ring.exe"
    if language == "c":
        need("cc")
        compiler, run = ["cc", "-std=gnu11", "-Wall", "-Werror", "-o", str(binary), str(EXAMPLES / "c/ring.c")], []
    else:
        need("mcs", "mono")
        compiler, run = ["mcs", "-warnaserror", "-warn:4", f"-out:{binary}", str(EXAMPLES / "csharp/Ring.cs")], ["mono"]
    subprocess.run(compiler, check=True)
    layout = RingLayout(2, 2, (FrameShape(16, 16, "Mono8"), FrameShape(20, 30, "Mono16")), 4096)
    with Ring.create(tmp_path / "c.ring", layout) as ring:
        ring.claim(1)
        for slot, state, row, grey in ((ring.slot(1, 0, 1), OK, 5, 7), (ring.slot(1, 1, 0), INCOMPLETE, 2, 300)):
            ring.frame(slot)[:] = np.array(grey)
            ring.write_slot_record(slot, state, row, 1)
        done = subprocess.run([*run, binary, ring.path, "1"], check=True, capture_output=True, text=True)
        assert done.stdout.splitlines() == ["camera 0 row 5 ok 7.000", "camera 1 row 2 incomplete 300.000"]
        assert subprocess.run([*run, binary, ring.path, "2"], check=False, capture_output=True).returncode != 0
