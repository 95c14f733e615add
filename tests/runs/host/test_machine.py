"""What the machine states: addresses, clock, mounts."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError
from vaoi_station.runs.host.machine import RemountWatch, clock_state


def test_a_clock_that_no_program_keeps_right_has_no_error_bound() -> None:
    state = clock_state()
    assert state.synchronised in (True, False, None)
    assert (state.max_error_s is not None) == bool(state.synchronised)


ROOT = "20 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw,errors=remount-ro"


def write_mounts(file: Path, mount: str, disk: str, point: str) -> None:
    """Write a table in which `point` is mounted over an older mount."""
    old, new = (
        f"{n} 20 8:2 / {point} {options} shared:2 master:1 - ext4 /dev/sdb1 "
        for n, options in ((21, "rw"), (22, mount))
    )
    file.write_text("\n".join([ROOT, old + "rw", new + disk, "23 20 0:5 / /elsewhere ro - tmpfs tmpfs ro", "short"]))


def test_a_service_starts_again_when_the_disk_is_writable_and_nothing_is_lost(tmp_path: Path) -> None:
    mounts, starts = tmp_path / "mounts", list[None]()
    watch = RemountWatch(tmp_path, lambda: starts.append(None), mounts)
    write_mounts(mounts, "ro", "ro", str(tmp_path.resolve()))
    watch.check()
    write_mounts(mounts, "ro", "rw", str(tmp_path.resolve()))
    with pytest.raises(DeviceError, match="mounted read-only where the service sees it") as refusal:
        watch.check(at_risk=3)
    assert "3 runs that wait in memory or are under way are lost" in refusal.value.action
    assert refusal.value.code == "storage-read-only"
    assert starts == []
    watch.check()
    assert starts == [None]
