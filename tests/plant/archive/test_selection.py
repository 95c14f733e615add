"""Runs are selected by type, time, station and verdict."""

from __future__ import annotations

import pytest

from vaoi_station.errors import InputError
from vaoi_station.model import Status
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.archive.selection import RunSelection

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


def test_a_folder_is_listed_if_it_may_have_such_runs() -> None:
    noon = RunSelection(since="2026-03-02T12:00:00Z", until="2026-03-03T12:00:00Z")
    days = ("2026-03-01", "2026-03-02", "2026-03-03", "2026-03-04")
    assert [noon.admits_folder("one", day) for day in days] == [False, True, True, False]


@pytest.mark.parametrize("text", ["yesterday", "2026-03-02T12:00:00"])
def test_a_time_without_a_zone_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="since"):
        RunSelection(since=text)
