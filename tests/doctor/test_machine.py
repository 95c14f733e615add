"""Read the kernel's files, from copies and from this machine."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from vaoi_station.doctor.machine import Machine


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
