from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.api.setup import station_files
from vaoi_station.api.setup.station_files import StationFiles, replace_with_backup
from vaoi_station.errors import StateError


def test_a_copy_of_the_file_before_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station_files, "_MOST_BACKUPS", 2)
    path = tmp_path / "calibration.json"
    assert replace_with_backup(path, b"0") is None
    path.chmod(0o600)
    names = [replace_with_backup(path, content) for content in (b"1", b"2", b"3")]
    assert path.read_bytes() == b"3"
    assert path.stat().st_mode & 0o777 == 0o600
    kept = sorted(tmp_path.glob("calibration.before-*.json"))
    assert [file.name for file in kept] == names[1:]
    assert [file.read_bytes() for file in kept] == [b"1", b"2"]


def test_an_old_copy_that_cannot_be_deleted_is_no_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station_files, "_MOST_BACKUPS", 1)
    path = tmp_path / "calibration.json"
    path.write_bytes(b"0")
    (tmp_path / "calibration.before-2000.json").mkdir()
    assert replace_with_backup(path, b"1") is not None
    assert path.read_bytes() == b"1"


def test_a_refusal_names_the_file_and_the_command_of_the_administrator(protected: StationFiles) -> None:
    before = protected.path.read_bytes()
    with pytest.raises(StateError, match=r"station\.toml: the service may not write here") as refused:
        replace_with_backup(protected.path, b"new")
    assert refused.value.code == "settings-read-only"
    assert refused.value.action.endswith(f"sudo install -b -m 640 -o root -g vaoi station.toml {protected.path}")
    assert protected.path.read_bytes() == before
