"""Check the machine: cache of compiled code, clock, memory, socket buffers, USB."""

from __future__ import annotations

import os
import pwd
import sys
from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, changed, only, with_aravis, with_config, without_privileges
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.doctor import file_checks, machine_checks, running_station
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext


def test_no_writable_cache_for_compiled_code_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert machine_checks.judge_cache(str(tmp_path), locked, locked).level is Level.OK
    for given in (str(locked / "cache"), None):
        with without_privileges():
            finding = machine_checks.judge_cache(given, locked / "package", locked / "home")
        assert_problem(finding, Level.WARNING, "every start compiles")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine whose unit runs this environment as this user; its cache is `cache` in the folder returned."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    units = tmp_path / "usr/lib/systemd/system"
    units.mkdir(parents=True)
    unit = (Path(__file__).parents[2] / "deploy/vaoi-station.service").read_text()
    user = pwd.getpwuid(os.getuid()).pw_name
    for old, new in (
        ("/opt/vaoi-station/venv", sys.prefix),
        ("User=vaoi", f"User={user}"),
        ("/var/cache/vaoi-station", f"{tmp_path}/cache"),
    ):
        assert old in unit
        unit = unit.replace(old, new)
    (units / machine_checks.UNIT).write_text(unit)
    return tmp_path


def test_the_cache_is_that_of_the_service_whoever_runs_the_doctor(installed: Path) -> None:
    finding = only(machine_checks.compiled_code_cache(Machine(installed)))
    assert (finding.level, finding.message) == (Level.OK, f"will be stored in {installed}/cache by the service")
    (installed / "cache").mkdir()
    assert (
        only(machine_checks.compiled_code_cache(Machine(installed))).message
        == f"is stored in {installed}/cache by the service"
    )


def test_ring_on_a_disk_is_a_warning(context: CheckContext, tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    mounts = f"proc /proc proc rw 0 0\n/dev/sda1 / ext4 rw 0 0\ntmpfs {tmp_path}/shm tmpfs rw 0 0\n"
    (tmp_path / "proc" / "mounts").write_text(mounts)
    assert only(machine_checks.ring_space(CheckContext(context.config, Machine(tmp_path), None))).level is Level.OK
    (tmp_path / "proc" / "mounts").write_text(mounts.replace("tmpfs ", "ext4 ").replace(" tmpfs rw", " ext4 rw"))
    last = list(machine_checks.ring_space(CheckContext(context.config, Machine(tmp_path), None)))[-1]
    assert_problem(last, Level.WARNING, "is on ext4, not in memory")


def test_directory_that_this_user_cannot_see_is_a_fault(context: CheckContext) -> None:
    hidden = context.config.data.parent / "hidden"
    hidden.mkdir(mode=0)
    config = context.config.model_copy(update={"board_types": hidden / "types", "calibration": hidden / "c.json"})
    config = changed(config, "ring", directory=hidden / "shm")
    for check in (file_checks.board_types, file_checks.calibration, machine_checks.ring_space):
        with without_privileges():
            finding = only(check(with_config(context, config)))
        assert_problem(finding, Level.FAULT, "hidden")


def test_process_that_owns_the_ring(config: StationConfig) -> None:
    """The ring of a running process needs no further memory, and the kernel reports whether it is locked."""
    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        found = running_station.find(config)
        assert found is not None
        assert found.pid == os.getpid()
        assert found.no_reply_reason
        owned = CheckContext(config, Machine(), found)
        assert only(machine_checks.ring_space(owned)).level is Level.OK
        expected = Level.WARNING if ring.lock_note else Level.OK
        assert only(machine_checks.lock_limit(owned)).level is expected
    assert running_station.find(config) is None


@pytest.mark.parametrize(
    ("granted", "level"),
    [("15", Level.FAULT), ("16", Level.OK), ("0", Level.OK), (None, Level.NOT_APPLICABLE)],
)
def test_usb_memory(config: StationConfig, tmp_path: Path, granted: str | None, level: Level) -> None:
    """Two cameras need 8 MB each; 0 means no limit."""
    if granted is not None:
        parameter = tmp_path / machine_checks.USB_PARAMETER
        parameter.parent.mkdir(parents=True)
        parameter.write_text(granted + "\n")
    finding = only(machine_checks.usb_memory(CheckContext(with_aravis(config, serials=True), Machine(tmp_path), None)))
    assert finding.level is level
    if level is Level.FAULT:
        assert_problem(finding, level, "usbfs_memory_mb is 15, 2 cameras on USB need 16")
