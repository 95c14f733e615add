"""Manifests, selections and records of stations."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from vaoi_station.model import Status
from vaoi_station.plant.manifest import (
    RUN_FILE,
    ArchivedRun,
    RunSelection,
    read_record,
)


@pytest.mark.parametrize("time", ["2026-02-30T10:00:00Z", "2026-03-01T25:00:00Z", "0000-03-01T10:00:00Z"])
def test_a_time_that_does_not_exist_is_refused(time: str) -> None:
    with pytest.raises(ValidationError, match="time"):
        ArchivedRun(run="r", station="s", time=time, board_type="t", pixels=8, documents={}, frames=())


RUN = ArchivedRun(
    run="r", station="line [1]", time="2026-03-02T08:00:00.500Z", board_type="psu-7", verdict=Status.OK, pixels=0,
    documents={}, frames=(),
)  # fmt: skip


@pytest.mark.parametrize(
    ("selection", "meant"),
    [
        (RunSelection(), True),
        (RunSelection(station="line [1]"), True),
        (RunSelection(station="line*", board_type="psu-?"), True),
        (RunSelection(station="line [?]"), True),
        (RunSelection(board_type="psu-[7]"), False),
        (RunSelection(board_type="psu"), False),
        (RunSelection(since="2026-03-02", until="2026-03-02"), True),
        (RunSelection(until="2026-03-01"), False),
        (RunSelection(since="2026-03-02T10:00:00.6+02:00"), False),
        (RunSelection(until="2026-03-02T08:00:00.500Z"), False),
        (RunSelection(verdict=Status.OK), True),
        (RunSelection(verdict=Status.FAILED), False),
    ],
)
def test_a_run_fulfils_all_conditions(selection: RunSelection, meant: bool) -> None:
    assert selection.admits(RUN) is meant


def test_what_an_archive_does_not_need_is_not_read(tmp_path: Path) -> None:
    made = {"method": "fiducials", "reference": "r1", "configuration": "12", "unknown": 3}
    (tmp_path / RUN_FILE).write_text(json.dumps({"id": "r2", "started": "now", "made_with": made, "frames": "many"}))
    record = read_record(tmp_path)
    assert record is not None
    assert record.made_with is not None
    assert (record.made_with.method, record.made_with.reference, record.made_with.terms) == ("fiducials", "r1", None)
