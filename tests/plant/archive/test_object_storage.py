"""Addresses that cannot be an archive are refused with what to install or correct."""

from __future__ import annotations

import sys

import pytest

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.plant.archive.object_storage import FsspecStorage


def test_without_the_extra_the_refusal_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(InputError, match=r"Install vaoi-station\[plant\]"):
        FsspecStorage("memory://a")


def test_an_unknown_system_is_refused() -> None:
    with pytest.raises(InputError, match="is no address of an archive"):
        FsspecStorage("nothing-like-it://a")


def test_errors_of_the_system_name_the_object(monkeypatch: pytest.MonkeyPatch) -> None:
    storage = FsspecStorage("memory://a")

    def fail(*_: object) -> None:
        raise RuntimeError("broken")

    monkeypatch.setattr("fsspec.implementations.memory.MemoryFileSystem.pipe_file", fail)
    with pytest.raises(DeviceError, match=r"memory://a/blobs/x: cannot be written \(RuntimeError: broken\)"):
        storage.write("blobs/x", b"")
