"""What the machine states: addresses, clock, mounts."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError
from vaoi_station.runs.host import machine as module
from vaoi_station.runs.host.machine import MountView, RemountWatch, clock_state, is_present, mount_view


@pytest.mark.parametrize("host", ["127.0.0.1", "::", "station.example"])
def test_addresses_of_this_machine_and_names_are_present(host: str) -> None:
    assert is_present(host)


def test_the_offset_is_that_of_the_present_time_zone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the present one also if it was set while the program ran, as `timedatectl set-timezone` does."""
    monkeypatch.setenv("TZ", "Asia/Kolkata")
    try:
        state = clock_state()
    finally:
        monkeypatch.undo()
        time.tzset()
    assert (state.time_zone, state.utc_offset_s) == ("Asia/Kolkata", 19_800)


def test_the_name_comes_from_the_link_of_the_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TZ", raising=False)
    zone = tmp_path / "zoneinfo" / "Europe" / "Berlin"
    zone.parent.mkdir(parents=True)
    zone.write_bytes(b"")
    monkeypatch.setattr(module, "LOCAL_TIME", tmp_path / "localtime")
    (tmp_path / "localtime").symlink_to(zone)
    assert clock_state().time_zone == "Europe/Berlin"
    (tmp_path / "localtime").unlink()
    assert clock_state().time_zone == time.localtime().tm_zone


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


def test_the_mount_that_is_seen_counts(tmp_path: Path) -> None:
    place, mounts = tmp_path / "a place" / "data", tmp_path / "mounts"
    place.mkdir(parents=True)
    write_mounts(mounts, "ro,noatime", "rw,ro_is_no_option", str(place.parent.resolve()).replace(" ", "\\040"))
    assert mount_view(place, mounts) == MountView(mount_read_only=True, disk_read_only=False)
    assert mount_view(Path("/"), mounts) == MountView(mount_read_only=False, disk_read_only=False)
    assert mount_view(place, tmp_path / "absent") is None


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
