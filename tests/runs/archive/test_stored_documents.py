"""Records of runs of every kind that a start may find."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.errors import DeviceError
from vaoi_station.runs.archive.stored_documents import cut_short, decided, readable, summary
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import detail_of, summary_of
from vaoi_station.runs.states.tables import RunState
from vaoi_station.store import RunRow


@pytest.fixture
def row(progress: Progress) -> RunRow:
    document = detail_of(progress)
    texts = summary_of(document).model_dump_json(), document.model_dump_json()
    return RunRow(document.id, document.state, None, "b", "c", *texts)


@pytest.mark.parametrize("state", [*RunState, "a state of a later version", ""])
def test_a_run_without_an_end_is_ended_whatever_its_state(row: RunRow, state: str) -> None:
    ended = cut_short(replace(row, state=state), 7)
    assert (ended.state, ended.finish_number) == ("gone", 7)
    shown, document = summary(ended, RunState.GONE), decided(ended.detail, ended.summary)
    assert [reason.code for reason in document.reasons] == ["station-restarted"]
    assert (shown.state, shown.stored, shown.verdict, document.verdict) == ("gone", True, "failed", "failed")


def test_a_record_that_cannot_be_read_is_ended_and_listed_as_such(row: RunRow) -> None:
    odd = cut_short(replace(row, summary='{"new": 1}', detail="{"), 8)
    assert (odd.state, odd.finish_number, odd.detail) == ("gone", 8, "{")
    shown = summary(odd, RunState.GONE)
    assert (shown.id, [reason.code for reason in shown.reasons]) == (row.id, ["record-unreadable"])
    with pytest.raises(DeviceError, match="cannot be read") as refusal, readable(odd.id):
        decided(odd.detail, odd.summary)
    assert refusal.value.code == "record-unreadable"
