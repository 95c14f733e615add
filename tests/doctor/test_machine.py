"""Read the kernel's files, from copies and from this machine."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from vaoi_station.doctor.machine import Machine, format_bytes, is_directory, nearest, writable


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """A machine with a few files of /proc and /sys."""
    proc = tmp_path / "proc"
    (proc / "sys/net/core").mkdir(parents=True)
    (proc / "sys/net/core/rmem_max").write_text("212992\n")
    (proc / "meminfo").write_text("MemTotal: 100 kB\nMemFree: 1 kB\nMemAvailable: 42 kB\n")
    (proc / "self").mkdir()
    (proc / "self/status").write_text("Name:\tpython\nCapEff:\t0000000000000000\n")
    (proc / "7").mkdir()
    (proc / "7/status").write_text("VmLck:\t     8 kB\n")
    return Machine(tmp_path)


def test_values_are_read_and_absent_ones_are_none(machine: Machine) -> None:
    assert machine.sysctl("net.core.rmem_max") == 212992
    assert machine.sysctl("net.core.absent") is None
    assert machine.text("proc/absent") is None
    assert machine.number("proc/meminfo") is None
    assert machine.available_memory() == 42 * 1024
    assert machine.locked_bytes(7) == 8 * 1024
    assert machine.locked_bytes(8) is None


@pytest.mark.parametrize(
    ("capabilities", "allowed"), [("0", False), ("4000", True), ("1ffffffffff", True), ("bfff", False)]
)
def test_capability_to_lock_memory(machine: Machine, capabilities: str, allowed: bool) -> None:
    (machine.root / "proc/self/status").write_text(f"CapEff:\t{capabilities}\n")
    assert machine.may_lock_anything() == allowed


def test_the_longest_and_last_mount_point_holds_a_path(machine: Machine, tmp_path: Path) -> None:
    lines = [
        "/dev/a / ext4 rw 0 0", f"/dev/b {tmp_path} xfs rw 0 0", f"t {tmp_path}/with\\040space tmpfs rw 0 0",
        f"/dev/c {tmp_path} btrfs rw 0 0", "short",
    ]  # fmt: skip
    (machine.root / "proc/mounts").write_text("\n".join(lines))
    assert machine.filesystem_of(Path("/srv")) == "ext4"
    assert machine.filesystem_of(tmp_path / "x") == "btrfs"
    assert machine.filesystem_of(tmp_path / "with space" / "x") == "tmpfs"


def test_kinds_of_devices(machine: Machine) -> None:
    entry = machine.root / "sys/dev/char/4:64"
    entry.mkdir(parents=True)
    (machine.root / "sys/class/tty").mkdir(parents=True)
    (machine.root / "sys/class/mem").mkdir()
    (entry / "subsystem").symlink_to(machine.root / "sys/class/tty")
    other = machine.root / "sys/dev/char/1:3"
    other.mkdir()
    (other / "subsystem").symlink_to(machine.root / "sys/class/mem")
    assert machine.is_terminal(os.makedev(4, 64))
    assert machine.is_terminal(os.makedev(136, 0)), "pseudo-terminals have no entry in /sys"
    assert machine.is_terminal(os.makedev(200, 0)), "unknown devices are not refused"
    assert not machine.is_terminal(os.makedev(1, 3))


def test_holders_of_an_open_file(tmp_path: Path) -> None:
    path = tmp_path / "port"
    with path.open("w"):
        assert os.getpid() in [holder.pid for holder in Machine().holders(path)]
    assert list(Machine().holders(path)) == []


def test_places_in_the_file_system(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert nearest(tmp_path / "a" / "b") == tmp_path
    assert writable(tmp_path / "a" / "b")
    assert not writable(tmp_path / "file")
    assert is_directory(tmp_path)
    assert not is_directory(tmp_path / "file")
    assert not is_directory(tmp_path / "a")


@pytest.mark.parametrize(
    ("count", "text"), [(2.1e9, "2.1 GB"), (348e6, "348 MB"), (64e3, "64 kB"), (999, "0.999 kB"), (0, "0 kB")]
)
def test_bytes_as_text(count: float, text: str) -> None:
    assert format_bytes(count) == text
