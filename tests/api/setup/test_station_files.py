from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.api.setup import station_files
from vaoi_station.api.setup.station_files import replace_with_backup


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
