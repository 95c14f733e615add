"""What the coordinator refuses, and what it makes of processes that die."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.process import messages
from vaoi_station.errors import DeviceError, InternalError
from vaoi_station.model import Pulse, Status
from vaoi_station.runs.workers.jobs import Reply, WorkerLostError


def test_an_order_while_a_board_passes_takes_effect_after_it(rig: Any) -> None:
    """A caller waits for it or does not, as it wishes; the board that passes keeps its own order."""
    grant = rig.arm(board_id="b 1")
    rig.begin(grant)
    rig.until("filming")
    said = rig.coordinator.arm("small", "b 2", passing="after")
    assert (said.armed_with.board_id, said.next_order.board_id) == ("b 1", "b 2")
    with ThreadPoolExecutor(1) as caller:
        waiting = caller.submit(rig.coordinator.arm, "small", "b 3")
        rig.wait_for(lambda: rig.coordinator.snapshot().next_order.board_id == "b 3", "the second order")
        assert not waiting.done()
        rig.finish(grant, rig.row(grant, 0))
        now = waiting.result(20.0)
    assert (now.armed_with.board_id, now.next_order) == ("b 3", None)
    assert rig.result_of(grant.run).board_id == "b 1"


def test_an_order_for_which_nobody_waits_reports_why_it_took_no_effect(rig: Any) -> None:
    grant = rig.arm()
    rig.begin(grant)
    rig.until("filming")
    rig.coordinator.arm("small", passing="after")
    rig.peer.die()
    rig.until("faulted")
    said = [e.message for e in rig.coordinator.events() if "given while a board passed" in e.message]
    assert len(said) == 1
    assert "did not take effect: The station is faulted" in said[0]


def _lose(rig: Any, *cameras: int) -> None:
    """Report in the next heartbeat that these cameras are not connected."""
    refusal = CameraHealth(False, "it refuses Gain = 99", action="Set a gain that it can do.")
    health = tuple(refusal if k in cameras else CameraHealth(True) for k in range(2))
    rig.peer.report(messages.Health(health, "controller fine", time.monotonic()))
    complete = not cameras
    rig.wait_for(
        lambda: (seen := rig.coordinator.snapshot()).controller and seen.all_cameras_ready is complete, "the health"
    )


def test_without_one_of_its_cameras_the_line_is_not_armed_unless_that_is_allowed(rig: Any) -> None:
    _lose(rig, 1)
    with pytest.raises(DeviceError, match=r"Camera c1 is not connected\. It refuses Gain = 99") as refusal:
        rig.coordinator.arm("small")
    assert refusal.value.code == "camera-lost"
    assert refusal.value.action.startswith("Set a gain that it can do. To film boards without it")
    assert "allow_lost_cameras" in refusal.value.action
    assert rig.coordinator.snapshot().state == "idle"
    assert rig.coordinator.snapshot().armed_with is None
    grant = rig.arm(allow_lost_cameras=True)
    rig.board(grant)
    assert rig.result_of(grant.run).state == "ready"
    assert [r.code for r in rig.coordinator.snapshot().reasons] == ["camera-lost"]


def test_a_line_that_loses_a_camera_continues_but_refuses_new_orders(rig: Any) -> None:
    """What was ordered goes on: the result names the missing frames. A new order is refused, and the old one holds."""
    grant = rig.arm(board_id="b 1")
    _lose(rig, 0)
    seen = rig.coordinator.snapshot()
    assert (seen.state, seen.all_cameras_ready) == ("armed", False)
    event = next(event for event in rig.coordinator.events() if event.kind == "camera")
    assert seen.cameras[0].lost_since is not None
    assert seen.cameras[0].lost_since[:16] == event.time[:16]
    assert {camera.lost_since for camera in seen.cameras[1:]} == {None}
    assert seen.reasons[0].message.startswith("Camera c0 is not connected.")
    with pytest.raises(DeviceError, match="The array is not complete"):
        rig.coordinator.arm("small", "b 2")
    rig.board(grant)
    assert rig.result_of(grant.run).board_id == "b 1"
    _lose(rig)
    rig.coordinator.arm("small", "b 2")
    reported = [event.message for event in rig.coordinator.events() if event.kind == "camera"]
    assert reported == ["Camera c0 is lost: boards would be filmed without it.", "Camera c0 is ready again."]


def test_acquisition_ends_in_mid_run_and_what_had_arrived_is_stitched(rig: Any) -> None:
    grant = rig.arm(board_id="b 1")
    rig.begin(grant)
    rig.peer.expect(messages.Grant)
    rig.row(grant, 0)
    rig.row(grant, 1)
    rig.wait_run(grant.run, lambda run: run.counts.ok == 4, "four frames")
    rig.peer.report(messages.PulseReported(grant.run, Pulse(index=2, time_s=100.2)))
    rig.wait_run(grant.run, lambda run: run.rows == 3, "three rows")
    rig.peer.die()
    run = rig.result_of(grant.run)
    assert (run.state, run.verdict) == ("degraded", Status.DEGRADED)
    assert rig.coordinator.stitch(run.id).status is Status.DEGRADED, "also for callers that read only the matrices"
    assert (run.counts.ok, run.counts.missing) == (4, 2)
    assert {reason.code for reason in run.reasons} == {"frames-missing", "acquisition-lost"}
    assert np.all(rig.coordinator.frame(grant.run, 1, 1)[0] == 31)
    rig.peer.wait_for_start(2)
    rig.peer.report(messages.Ready(2))
    rearmed = rig.peer.expect(messages.Grant)
    rig.peer.expect(messages.Arm)
    rig.peer.report(messages.Armed())
    rig.until("armed")
    rig.board(rearmed)
    after = rig.result_of(rearmed.run)
    assert after.board_id is None, "boards may have passed unnoticed, so the id may belong to another board"
    assert [reason.code for reason in after.reasons] == ["board-id-uncertain"]
    assert rig.link.status().restarts == 1


def test_the_cause_of_failed_starts_is_published_once_and_stays(rig: Any) -> None:
    absent = messages.Trouble("port-absent", "There is no serial port /dev/ttyUSB0.", "Plug it in.")
    refused = messages.Trouble("setting-refused", "Camera left refuses Gain = 99.", "Set what it can do.")
    first = rig.coordinator.snapshot().last_event
    rig.peer.die(-11)
    for life, cause in enumerate((absent, absent, refused), start=2):
        rig.peer.wait_for_start(life)
        rig.peer.report(cause)
        rig.peer.die(0)
    rig.peer.wait_for_start(5)
    rig.wait_for(lambda: rig.coordinator.snapshot().reasons[0].code == refused.code, "the second cause")
    assert [r.code for r in rig.coordinator.snapshot().reasons] == ["setting-refused", "acquisition-lost"]
    reported = [e.message for e in rig.coordinator.events(first) if e.kind == "trouble"]
    lost = "The acquisition process ended (code -11).", "The acquisition process could not start."
    assert reported == [lost[0], absent.message, lost[1], refused.message]
    rig.peer.report(messages.Ready(2))
    rig.until("idle")
    assert rig.coordinator.snapshot().reasons == ()


def test_a_task_that_fails_degrades_and_one_that_kills_fails_the_run(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.board(grant, rows=2)
    rig.wait_run(grant.run, lambda run: run.state == "stitching", "stitching")
    job = rig.workers.kept.pop()
    rig.workers.answer(job, Reply(None, InternalError("the link broke"), 0.0))
    rig.workers.perform_kept()
    run = rig.result_of(grant.run)
    assert run.state == "degraded"
    assert [r.message for r in run.reasons] == ["the link broke"]
    second = rig.peer.expect(messages.Grant)
    rig.workers.keep = True
    rig.board(second, rows=2)
    rig.wait_run(second.run, lambda run: run.state == "stitching", "stitching")
    job = rig.workers.kept.pop()
    rig.workers.answer(job, Reply(None, WorkerLostError(f"{job} took 2 workers with it"), 0.0))
    run = rig.result_of(second.run)
    assert run.state == "failed"
    assert "took 2 workers with it" in run.reasons[0].message
    assert np.all(rig.coordinator.frame(second.run, 0, 1)[0] == 11)


def test_boards_that_follow_too_closely_take_no_id_that_is_not_theirs(rig: Any) -> None:
    """Three boards: the second passes in the tail of the first, while SN-2 is armed; the third must not become SN-2."""
    first = rig.arm(board_id="SN-1")
    started_s = rig.begin(first)
    rig.workers.keep = True
    records = [r for row in range(3) for r in rig.row(first, row)]
    two = ((0.0, 0.3), (0.45, 0.75))
    rig.finish(first, records, interruptions=two)
    second = rig.peer.expect(messages.Grant)
    rig.until("armed")
    rig.coordinator.arm("small", "SN-2")
    rig.begin(second, started_s + 2.0)
    rig.wait_run(second.run, lambda run: run.state == "filming", "the third board")
    rig.workers.keep = False
    rig.workers.perform_kept()
    rig.finish(second, rig.row(second, 0))
    one, three = rig.result_of(first.run), rig.result_of(second.run)
    assert (one.verdict, one.state) == (Status.DEGRADED, "degraded")
    assert [reason.code for reason in one.reasons] == ["boards-too-close", "board-id-uncertain"]
    assert tuple((i.blocked_s, i.clear_s) for i in one.interruptions) == two
    assert rig.coordinator.stitch(one.id).status is Status.DEGRADED
    assert (three.board_id, three.verdict) == (None, Status.DEGRADED)
    assert [reason.code for reason in three.reasons] == ["board-id-uncertain"]
    snapshot = rig.coordinator.snapshot()
    assert snapshot.boards_missed == 1
    assert not snapshot.armed_with.board_id_certain
    assert [warning.code for warning in snapshot.warnings] == ["board-id-uncertain"]
    [missed] = [e for e in rig.coordinator.events() if e.kind == "board-missed"]
    assert (missed.run, missed.code) == (one.id, "boards-too-close")
    rig.coordinator.arm("small", "SN-3")
    fourth = rig.peer.expect(messages.Grant)
    rig.board(fourth)
    assert rig.result_of(fourth.run).board_id == "SN-3"
    assert rig.coordinator.snapshot().warnings == ()
