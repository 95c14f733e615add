"""The calibration watched by a coordinator: a knocked camera becomes a warning, and stays one over a restart."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.runs.conftest import ScriptedWorkers
from vaoi_station.acquisition.process import messages
from vaoi_station.drift.checks import LampCheck
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.control import calibration_watch
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.workers.jobs import Reply, WantedCheck
from vaoi_station.store import RunRow, Store
from vaoi_station.store import documents as calibration_checks


def film(rig: Any, grant: messages.Grant) -> messages.Grant:
    """Let a board pass until its calibration check is done; returns the grant for the next one."""
    before = rig.coordinator.calibration().runs
    rig.board(grant)
    rig.result_of(grant.run)
    rig.wait_for(lambda: rig.coordinator.calibration().runs == before + 1, "the check")
    following: messages.Grant = rig.peer.expect(messages.Grant)
    return following


def test_a_displaced_camera_becomes_a_warning_with_its_second_board(rig: Any, calibration: Any) -> None:
    assert [c.state for c in rig.coordinator.calibration().cameras] == ["unknown", "unknown"]
    grant = film(rig, rig.arm())
    assert [c.state for c in rig.coordinator.calibration().cameras] == ["steady", "steady"]
    rig.workers.displacement_px = 3.0
    first = grant.run
    grant = film(rig, grant)
    assert rig.coordinator.snapshot().warnings == ()
    film(rig, grant)
    (warning,) = rig.coordinator.snapshot().warnings
    assert warning.code == "calibration-drift"
    assert f"is displaced by 3.00 px from its calibration since run {first}" in warning.message
    assert "recalibrate" in warning.action
    assert rig.coordinator.snapshot().state == "armed", "boards are still filmed"
    still, drifted = rig.coordinator.calibration().cameras
    assert (still.state, still.drift) == ("steady", None)
    assert (drifted.state, drifted.drift.y_px, drifted.drift.since_run, drifted.drift.runs) == (
        "drifted",
        3.0,
        first,
        2,
    )
    assert [m.y_px for m in drifted.history] == [0.0, 3.0, 3.0]
    reported = [e for e in rig.coordinator.events() if e.code == "calibration-drift"]
    assert len(reported) == 1
    rig.wait_for(lambda: rig.store.checks.count(rig.coordinator.calibration().digest) == 3, "the stored checks")
    again = CalibrationWatch(rig.store.checks, EventLog(rig.store), calibration, ["a", "b"])
    assert [w.code for w in again.warnings()] == ["calibration-drift"]
    assert again.status().runs == 3


def test_a_dim_light_is_a_warning_until_it_is_mended(store: Store, calibration: Any) -> None:
    events, now = EventLog(store), "2026-01-01T00:00:00Z"
    kept = store.keep_document("calibration", calibration.model_dump_json(), now)
    board_type = store.keep_document("board-type", '{"name": "b"}', now)
    watch = CalibrationWatch(store.checks, events, calibration, ["a", "b"])

    def pass_board(k: int, grey: float) -> None:
        lamps = tuple(
            LampCheck(camera=i, light=light, exposure=200.0, grey=grey if light == "left" else 80.0, points=900)
            for i in (0, 1)
            for light in ("even", "left")
        )
        run = f"r{k:02d}"
        check = ScriptedWorkers().check(run).model_copy(update={"lamps": lamps})
        store.save_run(RunRow(run, "ready", None, board_type, kept, "{}", "{}"))
        watch.checked(WantedCheck(run, check.time, "b", watch.digest), Reply(check, None, 0.0))

    for k in range(10):
        pass_board(k, 60.0 if k < 7 else 30.0)
        assert bool(watch.warnings()) == (k == 9)
    (warning,) = watch.warnings()
    assert warning.code == "lamp-dim"
    assert warning.message.startswith("Light left is dim in cameras a, b: boards have 50% of the brightness")
    assert "since run r07 (2026-01-01T00:00:00Z); 3 boards show it." in warning.message
    assert "the boards may be darker" not in warning.message
    assert "vaoi flatfield" in warning.action
    store.save_run(RunRow("r99", "ready", None, board_type, kept, "{}", "{}")).result(10)  # after the checks
    again = CalibrationWatch(store.checks, EventLog(store), calibration, ["a", "b"])
    assert again.warnings() == watch.warnings(), "it stays over a restart"
    pass_board(10, 60.0)
    pass_board(11, 60.0)
    assert watch.warnings() == ()
    assert [e.message for e in events.read(events.last - 1, 0.0, 1)] == ["Light left is as bright as before again."]


@pytest.mark.parametrize("restarted", ["never", "before", "after"])
def test_a_board_type_that_pauses_keeps_its_baseline(
    store: Store, calibration: Any, monkeypatch: pytest.MonkeyPatch, restarted: str
) -> None:
    monkeypatch.setattr(calibration_watch, "FIRST_CHECKS", 2)
    monkeypatch.setattr(calibration_watch, "LATEST_CHECKS", 8)
    monkeypatch.setattr(calibration_checks, "FIRST_KEPT", 0)
    monkeypatch.setattr(calibration_checks, "LATEST_KEPT", 10)
    now = "2026-01-01T00:00:00Z"
    kept = store.keep_document("calibration", calibration.model_dump_json(), now)
    board_type = store.keep_document("board-type", '{"name": "b"}', now)
    watches = [CalibrationWatch(store.checks, EventLog(store), calibration, ["a", "b"])]

    def pass_boards(runs: range, name: str, grey: float) -> None:
        for k in runs:
            lamp = LampCheck(camera=0, light="left", exposure=200.0, grey=grey, points=900)
            check = ScriptedWorkers().check(f"r{k:02d}")
            check = check.model_copy(update={"lamps": (lamp,), "board_type": name})
            store.save_run(RunRow(check.run, "ready", None, board_type, kept, "{}", "{}"))
            watches[-1].checked(WantedCheck(check.run, check.time, name, watches[-1].digest), Reply(check, None, 0.0))

    def restart() -> None:
        store.save_run(RunRow("r99", "ready", None, board_type, kept, "{}", "{}")).result(10)  # after the checks
        watches.append(CalibrationWatch(store.checks, EventLog(store), calibration, ["a", "b"]))

    pass_boards(range(8), "paused", 60.0)
    if restarted == "before":
        restart()
    pass_boards(range(8, 28), "other", 80.0)
    if restarted == "after":
        restart()
        left = (json.loads(text) for text in store.checks.documents(watches[-1].digest, 0, 100))
        assert {check["board_type"] for check in left} == {"other"}
    pass_boards(range(28, 31), "paused", 30.0)
    (warning,) = watches[-1].warnings()
    assert "50% of the brightness" in warning.message
