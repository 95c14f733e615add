"""Runs of a live station, handed over to an archive and stitched again: the results are equal to the last digit."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from tests.plant.conftest import outcome_of
from tests.system.conftest import config_of, film_one, until_state
from vaoi_station.config import ArchiveConfig, MethodName, ReplayConfig
from vaoi_station.model import Stitch
from vaoi_station.model.board_type import Visibility
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.cluster import software
from vaoi_station.plant.restitch import Terms
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.station import Station

TIMEOUT_S = 150.0
METHODS: tuple[MethodName, ...] = ("auto", "fiducials", "features", "reference")


def until_added(station: StationCoordinator, runs: int) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while (status := station.kept.archive_status()) is None or status.added < runs:
        assert time.monotonic() < deadline, status
        assert status is None or not status.refused, status
        station.events(station.snapshot().last_event, 0.1)  # The archive itself reports no addition.


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Archive, dict[str, tuple[str, Stitch]]]:
    """Return the archive of a station, and id and result of a run of every method, by method."""
    folder = tmp_path_factory.mktemp("station")
    twin = Twin(read_scenario(scenario_path("small")))
    write_passage(twin.passage(0), folder / "board")
    archive = Archive.create(folder / "archive")
    expected = twin.line.expected_board.model_copy(update={"tolerance_mm": 3.0, "rotation_tolerance_deg": 2.0})
    config = config_of(
        twin,
        folder,
        "replay",
        replay=ReplayConfig(recordings=(folder / "board",), pace="fast", pause_s=0.01),
        workers=1,
        line=twin.line.model_copy(update={"expected_board": expected}),
        archive=ArchiveConfig(url=archive.url, ok_every=1),
    )
    results: dict[str, tuple[str, Stitch]] = {}
    with Station(config) as started:
        until_state(started.coordinator, "idle")
        started.coordinator.teach_reference("small", film_one(started.coordinator).id, confirm_orientation=True)
        until_added(started.coordinator, 1)  # A station counts what it has added itself.
    # So that some components are seen too little: the result shows what the station asks for.
    with Station(config.model_copy(update={"visibility": Visibility(views=3)})) as started:
        station = started.coordinator
        until_state(station, "idle")
        for count, method in enumerate(METHODS, 1):
            station.set_method("small", method)
            run = film_one(station).id
            results[method] = run, station.stitch(run)
            until_added(station, count)  # Boards that follow at once would need the memory of its frames.
    return archive, results


def comparable(document: dict[str, Any]) -> dict[str, Any]:
    """Return a result without its times, and without the origin that only results of recordings have."""
    result: dict[str, Any] = json.loads(json.dumps(document))
    for key in ("timings_ms", "recording"):
        result["quality"].pop(key, None)
    return result


@pytest.mark.parametrize("method", METHODS)
def test_a_run_is_stitched_as_by_its_station(
    filmed: tuple[Archive, dict[str, tuple[str, Stitch]]], method: str, tmp_path: Path
) -> None:
    archive, results = filmed
    run, stitch = results[method]
    folder = archive.extract(run, tmp_path / "run")
    theirs = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert (theirs["method"], "reference" in theirs["quality"]) == (method, method in ("auto", "reference"))
    assert stitch.reasons == tuple(theirs["reasons"])
    assert theirs["quality"]["unseen"], "by less views than 3"
    document = outcome_of(archive, run, tmp_path, Terms(software()))
    assert comparable(document["result"]) == comparable(theirs), "to the last digit"
    assert document["notes"] == []
