"""A station that was shown a good board says which parts of the next one are absent."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.system.conftest import config_of, film_one, until_state
from vaoi_station.config import ReplayConfig
from vaoi_station.errors import GoneError, NotFoundError
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.simulation.scenario import AbsentPart
from vaoi_station.station import Station

ABSENT = ("C4", "R11")
TIMEOUT_S = 120.0


@pytest.fixture
def boards(tmp_path: Path) -> tuple[Path, Path]:
    """Return recordings of a good board and of one without some parts."""
    scenario = read_scenario(scenario_path("small"))
    faults = scenario.faults.model_copy(update={"absent_parts": tuple(AbsentPart(ref=ref) for ref in ABSENT)})
    write_passage(Twin(scenario).passage(0), tmp_path / "good")
    write_passage(Twin(scenario.model_copy(update={"faults": faults})).passage(1), tmp_path / "bad")
    return tmp_path / "good", tmp_path / "bad"


def announced(coordinator: StationCoordinator, run: str, kind: str, state: str) -> str:
    """Wait for an event about a run, and return its message."""
    seen, deadline = 0, time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        for record in coordinator.events(seen, 1.0):
            seen = record.number
            if (record.kind, record.run, record.state) == (kind, run, state):
                return record.message
    raise AssertionError(f"run {run} has no event {kind} {state}")


def test_a_taught_board_type_has_its_parts_measured_after_each_run(
    twin: Twin, boards: tuple[Path, Path], tmp_path: Path
) -> None:
    replay = ReplayConfig(recordings=boards, pace="fast", pause_s=0.01)
    station = Station(config_of(twin, tmp_path, "replay", replay=replay, workers=1))
    station.start()
    try:
        coordinator, found = station.coordinator, {}
        until_state(coordinator, "idle")
        # Boards pass in turn, also while the station is not armed: until the second one was filmed after the teaching.
        for _ in range(30):
            run = film_one(coordinator)
            if not coordinator.parts.good("small").boards:
                before = json.loads(coordinator.parts.document(run.id))
                assert before["good_boards"] == []
                if absent_in(before) & set(ABSENT):
                    continue
                taught = coordinator.parts.teach(run.id)
                assert [b.run for b in taught.boards] == [run.id]
                assert taught.disagreements == ()
                good = run.id
                coordinator.kept.pin(good)
                announced(coordinator, good, "recording", "")
                continue
            message = announced(coordinator, run.id, "parts", "measured")
            document = json.loads(coordinator.parts.document(run.id))
            assert document["good_boards"] == [good]
            found[frozenset(absent_in(document))] = message
            if frozenset(ABSENT) in found:
                break
        assert frozenset(ABSENT) in found
        assert set(found) <= {frozenset(), frozenset(ABSENT)}
        assert all(ref in found[frozenset(ABSENT)] for ref in ABSENT)
        beside = coordinator.parts.views(run.id, ABSENT[0])
        assert (beside.good, [view.difference is not None for view in beside.views]) == (good, [True])
        before = coordinator.parts.good("small")
        assert coordinator.parts.forget(good).boards == ()
        with suppress(GoneError):
            coordinator.release(good)
        assert coordinator.parts.teach(good) == before, "taught from its recording"
        assert coordinator.parts.forget(good).boards == ()
        with pytest.raises(NotFoundError):
            coordinator.parts.forget(good)
    finally:
        station.stop()


def absent_in(document: dict[str, Any]) -> set[str]:
    """Return the parts that a document calls absent."""
    return {ref for ref, p in document["parts"].items() if p.get("presence", 1.0) < 0.5}
