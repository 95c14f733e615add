"""Check the space for the ring and the permission to lock it."""

from __future__ import annotations

import os
import resource
from pathlib import Path

from tests.doctor.conftest import assert_problem, changed, only, with_config, without_privileges
from vaoi_station.acquisition.ring.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.doctor.check_context import CheckContext, RunningProcess
from vaoi_station.doctor.checks import configured_files, memory, running_station
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


def test_ring_that_fits_is_no_fault(context: CheckContext) -> None:
    levels = {finding.level for finding in memory.ring_space(context)}
    assert levels <= {Level.OK, Level.WARNING}  # a warning where the temporary directory is on a disk


def test_ring_larger_than_any_memory_is_a_fault(context: CheckContext) -> None:
    huge = with_config(context, changed(context.config, "line", longest_board_mm=1e9))
    assert_problem(next(iter(memory.ring_space(huge))), Level.FAULT, "3 runs × 2 cameras", "has")


def test_little_available_memory(context: CheckContext, tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    needed = context.layout.file_bytes
    for available, level in ((needed // 2, Level.FAULT), (needed + needed // 4, Level.WARNING), (2 * needed, Level.OK)):
        (tmp_path / "proc" / "meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {available // 1024} kB\n")
        poor = CheckContext(context.config, Machine(tmp_path), None)
        assert only(memory.ring_space(poor)).level is level


def test_absent_ring_directory_is_a_fault(context: CheckContext) -> None:
    context.config.ring.directory.rmdir()
    assert_problem(only(memory.ring_space(context)), Level.FAULT, "there is no directory")


def test_ring_on_a_disk_is_a_warning(context: CheckContext, tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    mounts = f"proc /proc proc rw 0 0\n/dev/sda1 / ext4 rw 0 0\ntmpfs {tmp_path}/shm tmpfs rw 0 0\n"
    (tmp_path / "proc" / "mounts").write_text(mounts)
    assert only(memory.ring_space(CheckContext(context.config, Machine(tmp_path), None))).level is Level.OK
    (tmp_path / "proc" / "mounts").write_text(mounts.replace("tmpfs ", "ext4 ").replace(" tmpfs rw", " ext4 rw"))
    last = list(memory.ring_space(CheckContext(context.config, Machine(tmp_path), None)))[-1]
    assert_problem(last, Level.WARNING, "is on ext4, not in memory")


def test_directory_that_this_user_cannot_see_is_a_fault(context: CheckContext) -> None:
    hidden = context.config.data.parent / "hidden"
    hidden.mkdir(mode=0)
    config = context.config.model_copy(update={"board_types": hidden / "types", "calibration": hidden / "c.json"})
    config = changed(config, "ring", directory=hidden / "shm")
    for check in (configured_files.board_types, configured_files.calibration, memory.ring_space):
        with without_privileges():
            finding = only(check(with_config(context, config)))
        assert_problem(finding, Level.FAULT, "hidden")


def test_low_limit_of_locked_memory_is_a_warning(context: CheckContext) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, hard))
    try:
        with without_privileges():
            finding = only(memory.lock_limit(context))
    finally:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (soft, hard))
    assert_problem(finding, Level.WARNING, "this user may lock 65.5 kB of memory, the ring has 18.4 MB")


def test_sufficient_limit_of_locked_memory_is_ok(context: CheckContext) -> None:
    assert memory.judge_lock(context.layout.file_bytes, context.layout.file_bytes).level is Level.OK
    assert memory.judge_lock(resource.RLIM_INFINITY, 10**12).level is Level.OK


def test_capability_to_lock_any_memory_is_ok(context: CheckContext, tmp_path: Path) -> None:
    (tmp_path / "proc" / "self").mkdir(parents=True)
    (tmp_path / "proc" / "self" / "status").write_text("CapEff:\t0000000000004000\n")
    finding = only(memory.lock_limit(CheckContext(context.config, Machine(tmp_path), None)))
    assert (finding.level, "CAP_IPC_LOCK" in finding.message) == (Level.OK, True)


def test_process_that_owns_the_ring(config: StationConfig) -> None:
    """The ring of a running process needs no further memory, and the kernel reports whether it is locked."""
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        found = running_station.find(config)
        assert found is not None
        assert found.pid == os.getpid()
        assert found.no_reply_reason
        owned = CheckContext(config, Machine(), found)
        assert only(memory.ring_space(owned)).level is Level.OK
        expected = Level.WARNING if ring.lock_note else Level.OK
        assert only(memory.lock_limit(owned)).level is expected
    assert running_station.find(config) is None


def test_running_station_that_could_not_lock_is_a_warning() -> None:
    assert_problem(memory.judge_locked(0, 1000, 7), Level.WARNING, "process 7 has not locked")
    assert_problem(memory.judge_locked(None, 1000, 7), Level.WARNING, "process 7 has not locked")
    assert memory.judge_locked(1000, 1000, 7).level is Level.OK


def test_lock_of_another_users_process_cannot_be_read(config: StationConfig) -> None:
    finding = only(memory.lock_limit(CheckContext(config, Machine(), RunningProcess(None))))
    assert finding.level is Level.NOT_APPLICABLE
