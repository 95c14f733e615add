"""What an archive reads of the record of a station."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from vaoi_station.errors import InputError
from vaoi_station.plant.archive.station_record import RUN_FILE, read_record


def test_a_recording_without_a_record_is_of_no_station(tmp_path: Path) -> None:
    assert read_record(tmp_path) is None


def test_what_an_archive_does_not_need_is_not_read(tmp_path: Path) -> None:
    made = {"method": "fiducials", "reference": "r1", "configuration": "12", "unknown": 3}
    (tmp_path / RUN_FILE).write_text(json.dumps({"id": "r2", "started": "now", "made_with": made, "frames": "many"}))
    record = read_record(tmp_path)
    assert record is not None
    assert record.made_with is not None
    assert (record.made_with.method, record.made_with.reference, record.made_with.terms) == ("fiducials", "r1", None)


def test_a_method_that_there_is_not_is_refused(tmp_path: Path) -> None:
    (tmp_path / RUN_FILE).write_text(json.dumps({"id": "r2", "started": "now", "made_with": {"method": "guess"}}))
    with pytest.raises(InputError, match=r"run\.json: made_with\.method"):
        read_record(tmp_path)
