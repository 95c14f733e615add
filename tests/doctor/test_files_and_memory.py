"""Files, disk, memory: every fault is made for real."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, changed, only, without_privileges
from tests.needs import lacking
from vaoi_station.acquisition.ring.ring import Ring, RingLayout, ring_path
from vaoi_station.config import ReplayConfig, StationConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import configured_files, memory, storage
from vaoi_station.doctor.checks import running_station as running
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine

ROOT = Path(__file__).resolve().parents[2]


def with_config(context: CheckContext, config: StationConfig) -> CheckContext:
    return CheckContext(config, context.machine, context.running)


def test_a_sound_station_has_nothing_to_complain_of(context: CheckContext) -> None:
    checks = (
        configured_files.calibration,
        configured_files.board_types,
        configured_files.stand_ins,
        storage.data,
        memory.ring_space,
    )
    for check in checks:
        levels = {finding.level for finding in check(context)}
        expected = {Level.OK, Level.WARNING} if check is memory.ring_space else {Level.OK}  # tmp_path may be on a disk
        assert levels <= expected, check


# ── documents ──


def test_a_calibration_of_another_array(context: CheckContext) -> None:
    cameras = (*context.config.cameras, context.config.cameras[0].model_copy(update={"name": "third"}))
    three = context.config.model_copy(update={"cameras": cameras})
    assert_problem(
        only(configured_files.calibration(with_config(context, three))), Level.FAULT, "calibration.json", "3"
    )


def test_a_calibration_that_is_not_there(context: CheckContext) -> None:
    context.config.calibration.unlink()
    assert_problem(only(configured_files.calibration(context)), Level.FAULT, "calibration.json: there is no such file")


def test_board_types_that_cannot_be_read_are_named_one_by_one(context: CheckContext) -> None:
    directory = context.config.board_types
    (directory / "broken.json").write_text('{"format": "vaoi-board",')
    (directory / "foreign.json").write_text('{"format": "something"}')
    bad = [f for f in configured_files.board_types(context) if f.level is Level.FAULT]
    assert [f.subject for f in bad] == ["broken.json", "foreign.json"]
    assert all(f.action for f in bad)


def test_no_directory_of_board_types_and_an_empty_one(context: CheckContext) -> None:
    shutil.rmtree(context.config.board_types)
    assert_problem(only(configured_files.board_types(context)), Level.FAULT, "there is no directory")
    context.config.board_types.mkdir()
    assert_problem(only(configured_files.board_types(context)), Level.WARNING, "nothing to arm with")


def test_board_types_of_somebody_else(context: CheckContext) -> None:
    for directory in (context.config.board_types, *context.config.board_types.parents):
        if directory.is_relative_to(Path("/tmp")) and os.access(directory, os.W_OK):
            directory.chmod(directory.stat().st_mode | 0o055)
    context.config.board_types.chmod(0o555)
    with without_privileges():
        finding = only(configured_files.board_types(context))
    assert_problem(finding, Level.WARNING, "cannot be written to")


def test_a_scenario_that_does_not_fit(context: CheckContext) -> None:
    assert_problem(
        only(configured_files.stand_ins(with_config(context, changed(context.config, "line", trigger_period_s=0.2)))),
        Level.FAULT,
        "period_s is 0.2",
    )


def test_recordings_that_are_not_there(context: CheckContext, tmp_path: Path) -> None:
    config = changed(context.config, "controller", backend="replay")
    config = config.model_copy(update={"replay": ReplayConfig(recordings=(tmp_path / "gone",))})
    assert_problem(only(configured_files.stand_ins(with_config(context, config))), Level.FAULT, "gone")


# ── disk ──


def test_a_data_directory_without_rights(context: CheckContext) -> None:
    locked = context.config.data.parent / "locked"
    locked.mkdir(mode=0o500)
    config = context.config.model_copy(update={"data": locked / "data"})
    with without_privileges():
        finding = only(storage.data(with_config(context, config)))
    assert_problem(finding, Level.FAULT, "locked/data cannot be written to by this user")


def test_data_where_a_file_is(context: CheckContext) -> None:
    context.config.data.write_text("")
    assert_problem(only(storage.data(context)), Level.FAULT, "is not a directory")


def test_a_directory_that_will_be_made_is_fine_and_is_not_made(context: CheckContext) -> None:
    assert only(storage.data(context)).level is Level.OK
    assert not context.config.data.exists()


def own_mounts() -> list[str]:
    """What to write before a command so that it may mount; where the kernel lets nobody, that is said."""
    for way in (["unshare", "-m"], ["unshare", "-rm"]):
        if subprocess.run([*way, "true"], capture_output=True, check=False).returncode == 0:
            return way
    return lacking("no mount name space may be made here (CAP_SYS_ADMIN, or user name spaces)")


IN_A_SMALL_WORLD = """
mount -t tmpfs -o size={size} tmpfs "$1/{directory}" && cd "$1" && exec "$2" -m vaoi_station doctor --json
"""


@pytest.mark.parametrize(
    ("directory", "size", "check", "level", "words"),
    [
        ("data", "1M", "disk", "fault", "200 MB are needed"),
        ("data", "1G", "disk", "warning", "kept recordings need more"),
        ("shm", "4M", "shared memory", "fault", "the ring needs 18.4 MB (3 runs × 2 cameras × 10 rows × 307 kB)"),
    ],
)
def test_a_file_system_that_is_full(
    station_toml: Path, directory: str, size: str, check: str, level: str, words: str
) -> None:
    """In a name space of its own, where anybody may mount one."""
    import json

    (station_toml.parent / directory).mkdir(exist_ok=True)
    script = IN_A_SMALL_WORLD.format(directory=directory, size=size)
    command = [*own_mounts(), "sh", "-c", script, "sh", str(station_toml.parent), sys.executable]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    found = [f for f in json.loads(done.stdout)["findings"] if f["check"] == check]
    assert [f["level"] for f in found] == [level]
    assert words in found[0]["message"]
    assert found[0]["action"]


def test_a_directory_that_is_hidden(context: CheckContext) -> None:
    hidden = context.config.data.parent / "hidden"
    hidden.mkdir(mode=0)
    config = context.config.model_copy(update={"board_types": hidden / "types", "calibration": hidden / "c.json"})
    config = changed(config, "ring", directory=hidden / "shm")
    for check in (configured_files.board_types, configured_files.calibration, memory.ring_space):
        with without_privileges():
            finding = only(check(with_config(context, config)))
        assert_problem(finding, Level.FAULT, "hidden")


# ── memory ──


def test_a_ring_larger_than_any_memory(context: CheckContext) -> None:
    config = changed(context.config, "line", longest_board_mm=1e9)
    assert_problem(
        next(iter(memory.ring_space(with_config(context, config)))), Level.FAULT, "3 runs × 2 cameras", "has"
    )


def test_a_machine_with_little_memory_left(context: CheckContext, tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    needed = context.layout.file_bytes
    for available, level in ((needed // 2, Level.FAULT), (needed + needed // 4, Level.WARNING), (2 * needed, Level.OK)):
        (tmp_path / "proc" / "meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {available // 1024} kB\n")
        poor = CheckContext(context.config, Machine(tmp_path), None)
        assert only(memory.ring_space(poor)).level is level


def test_no_directory_for_the_ring(context: CheckContext) -> None:
    context.config.ring.directory.rmdir()
    assert_problem(only(memory.ring_space(context)), Level.FAULT, "there is no directory")


def test_a_ring_on_a_disk_is_told(context: CheckContext, tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    mounts = f"proc /proc proc rw 0 0\n/dev/sda1 / ext4 rw 0 0\ntmpfs {tmp_path}/shm tmpfs rw 0 0\n"
    (tmp_path / "proc" / "mounts").write_text(mounts)
    assert only(memory.ring_space(CheckContext(context.config, Machine(tmp_path), None))).level is Level.OK
    (tmp_path / "proc" / "mounts").write_text(mounts.replace("tmpfs ", "ext4 ").replace(" tmpfs rw", " ext4 rw"))
    last = list(memory.ring_space(CheckContext(context.config, Machine(tmp_path), None)))[-1]
    assert_problem(last, Level.WARNING, "is on ext4, not in memory")


def test_a_user_who_may_lock_little(context: CheckContext) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, hard))
    try:
        with without_privileges():
            finding = only(memory.lock_limit(context))
    finally:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (soft, hard))
    assert_problem(finding, Level.WARNING, "this user may lock 65.5 kB of 18.4 MB")
    assert memory.judge_lock(context.layout.file_bytes, context.layout.file_bytes).level is Level.OK
    assert memory.judge_lock(resource.RLIM_INFINITY, 10**12).level is Level.OK


def test_a_process_that_has_its_ring(config: StationConfig) -> None:
    """A ring that lives is somebody's: its memory is there already, and the kernel knows whether it is locked."""
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        found = running.find(config)
        assert found is not None
        assert found.pid == os.getpid()
        assert found.no_reply_reason
        held = CheckContext(config, Machine(), found)
        assert only(memory.ring_space(held)).level is Level.OK
        expected = Level.WARNING if ring.lock_note else Level.OK
        assert only(memory.lock_limit(held)).level is expected
    assert running.find(config) is None


def test_a_running_station_that_could_not_lock() -> None:
    assert_problem(memory.judge_locked(0, 1000, 7), Level.WARNING, "process 7 has not locked")
    assert_problem(memory.judge_locked(None, 1000, 7), Level.WARNING, "process 7 has not locked")
