"""The conductor against a scripted acquisition process: the life of boards, and what goes wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition import messages as said
from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.errors import BusyError, DeviceError, GoneError, InputError, InternalError, NotFoundError, StateError
from vaoi_station.model import BoardType, Pulse, Status, Verdict
from vaoi_station.runs import reasons
from vaoi_station.runs.jobs import Answer, ConcludeJob, LinkJob, RenderJob


def test_a_board_passes(rig: Any) -> None:
    grant = rig.arm(board_id="b 1", job_id="j 7")
    assert rig.conductor.snapshot().state == "armed"
    rig.board(grant, rows=3)
    run = rig.result_of(grant.run)
    assert (run.id, run.state, run.verdict) == (grant.run, "ready", Status.OK)
    assert (run.board_type, run.board_id, run.job_id) == ("small", "b 1", "j 7")
    assert (run.rows, run.counts.ok, run.counts.missing, run.ended) == (3, 6, 0, "clear")
    assert run.belt is not None
    assert run.belt.ratio == pytest.approx(1.01)
    assert run.timings is not None
    assert run.timings.links == len(rig.workers.tasks(grant.run)) == len(rig.conductor.timeline(grant.run).tasks)
    assert run.timings.ready_after_last_frame_ms > 0
    assert rig.conductor.stitch(grant.run).status is Status.OK
    assert rig.conductor.next_run(None, 0.0) is None
    assert rig.workers.closed == [grant.run]


def test_links_are_asked_for_as_soon_as_both_frames_are_there(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.begin(grant)
    rig.row(grant, 0)
    rig.row(grant, 1)
    rig.wait_run(grant.run, lambda run: run.counts.ok == 4, "four frames")
    asked = {(j.task.kind, j.task.a, j.task.b) for j, _ in rig.workers.kept}
    assert {("rows", (0, 0), (0, 1)), ("rows", (1, 0), (1, 1)), ("neighbours", (0, 0), (1, 0))} <= asked
    assert rig.conductor.run(grant.run).state == "filming"
    with pytest.raises(StateError, match="no result yet"):
        rig.conductor.stitch(grant.run)


def test_a_run_is_concluded_when_the_last_link_is_there_and_not_before(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.board(grant, rows=2)
    rig.wait_run(grant.run, lambda run: run.state == "stitching", "the run to be stitched")
    *links, last = rig.workers.kept
    assert all(isinstance(job, LinkJob) for job, _ in rig.workers.kept)
    rig.workers.keep = False
    for job, done in links:
        rig.workers.perform(job, done)
    assert rig.conductor.run(grant.run).state == "stitching"
    assert not any(isinstance(job, ConcludeJob) for job in rig.workers.done)
    rig.workers.perform(*last)
    assert rig.result_of(grant.run).state == "ready"


def test_lost_frames_are_named_and_bridged(rig: Any) -> None:
    grant = rig.arm()
    rig.board(grant, rows=3, verdicts={0: Verdict.MISSING, 1: Verdict.INCOMPLETE})
    run = rig.result_of(grant.run)
    assert (run.counts.ok, run.counts.incomplete, run.counts.missing) == (4, 1, 1)
    words = [reason.message for reason in run.reasons]
    assert any("(0, 1) are missing: scripted" in word for word in words)
    bridges = {(t.a, t.b) for t in rig.workers.tasks(grant.run) if t.kind == "rows"}
    assert bridges <= {((0, 0), (0, 2)), ((1, 0), (1, 2))}


def test_boards_back_to_back_find_memory_granted_ahead(rig: Any) -> None:
    grants = [rig.arm(board_id="b")]
    for _ in range(6):
        rig.begin(grants[-1])
        grants.append(rig.peer.expect(said.Grant))
        records = [r for row in range(2) for r in rig.row(grants[-2], row)]
        rig.finish(grants[-2], records)
    last = rig.result_of(grants[-2].run)
    runs = rig.conductor.runs()
    assert [r.id for r in runs] == [g.run for g in reversed(grants[:-1])]
    states = [r.state for r in runs]
    assert states[0] == "ready"
    assert states[-1] == "gone"
    assert last.frames_available
    assert rig.conductor.snapshot().boards_missed == 0


def test_every_finished_run_is_told_once_and_in_order(rig: Any) -> None:
    assert rig.conductor.latest() is None
    got: list[str] = []
    listening = threading.Event()

    def follow() -> None:
        listening.set()
        first = rig.conductor.next_run(None, 20.0)
        while first is not None and len(got) < 3:
            got.append(first.id)
            first = rig.conductor.next_run(first.id, 20.0)

    follower = threading.Thread(target=follow)
    follower.start()
    assert listening.wait(10)
    grant, expected = rig.arm(), []
    for _ in range(4):
        rig.board(grant, rows=2)
        rig.result_of(grant.run)
        expected.append(grant.run)
        grant = rig.peer.expect(said.Grant)
    follower.join(20)
    assert got in (expected[:3], expected[1:4])
    assert rig.conductor.next_run(expected[-1], 0.01) is None
    assert rig.conductor.next_run(expected[0], 0.0).id == expected[1]


def test_a_run_that_begins_before_the_last_has_settled(rig: Any) -> None:
    first = rig.arm()
    rig.begin(first)
    records = [r for row in range(2) for r in rig.row(first, row)]
    second = rig.peer.expect(said.Grant)
    rig.begin(second)
    rig.finish(first, records)
    rig.result_of(first.run)
    assert rig.conductor.snapshot().state == "filming"
    rig.finish(second, rig.row(second, 0))
    rig.result_of(second.run)
    rig.until("armed")


def test_runs_end_in_the_order_their_boards_came(rig: Any) -> None:
    rig.workers.keep = True
    first = rig.arm()
    rig.board(first, rows=1)
    second = rig.peer.expect(said.Grant)
    rig.board(second, rows=1)
    rig.wait_run(second.run, lambda run: run.state == "stitching", "the second board")
    waiting, rig.workers.kept = rig.workers.kept, []
    rig.workers.keep = False
    for job, done in waiting:
        if job.run == second.run:
            rig.workers.perform(job, done)
    assert rig.conductor.run(second.run).state == "stitching"
    for job, done in waiting:
        if job.run == first.run:
            rig.workers.perform(job, done)
    rig.result_of(second.run)
    assert rig.conductor.next_run(first.run, 0.0).id == second.run


# --- ids, and how long they hold


def test_a_new_order_while_armed_is_for_the_boards_that_come_from_then_on(rig: Any) -> None:
    grant = rig.arm(board_id="b 1")
    before_s = time.monotonic()
    rig.conductor.arm("small", "b 2")
    rig.begin(grant, at_s=before_s)
    rig.finish(grant, rig.row(grant, 0))
    assert rig.result_of(grant.run).board_id == "b 1"
    second = rig.peer.expect(said.Grant)
    rig.board(second)
    assert rig.result_of(second.run).board_id == "b 2"


def test_armed_for_one_run_the_line_disarms_by_itself(rig: Any) -> None:
    grant = rig.arm(runs=1)
    rig.board(grant)
    rig.peer.expect(said.Disarm)
    rig.peer.say(said.Disarmed(()))
    rig.until("idle")
    assert rig.result_of(grant.run).state == "ready"
    assert rig.conductor.snapshot().armed_with is None


def test_arming_while_the_line_disarms_waits_for_that(rig: Any) -> None:
    grant = rig.arm(runs=1)
    rig.board(grant)
    rig.peer.expect(said.Disarm)
    again = threading.Thread(target=rig.conductor.arm, args=("small", "next"))
    again.start()
    rig.wait_for(lambda: bool(rig.conductor._core._after_disarm), "the order to wait")
    rig.peer.say(said.Disarmed(()))
    rig.peer.expect(said.Grant)
    rig.peer.expect(said.Arm)
    rig.peer.say(said.Armed())
    again.join(20)
    assert rig.conductor.snapshot().armed_with.board_id == "next"


def test_disarming_gives_the_unused_memory_back(rig: Any) -> None:
    grant = rig.arm()
    caller = threading.Thread(target=rig.conductor.disarm)
    caller.start()
    rig.peer.expect(said.Disarm)
    rig.peer.say(said.Disarmed((grant,)))
    caller.join(20)
    snapshot = rig.conductor.snapshot()
    assert snapshot.state == "idle"
    assert {bay.use for bay in snapshot.ring.bays} == {"free"}
    assert rig.conductor.disarm().state == "idle"


# --- refusals


def test_a_board_type_nobody_taught(rig: Any) -> None:
    with pytest.raises(NotFoundError, match="no board type 'unknown'; taught are: 'small'"):
        rig.conductor.arm("unknown")
    assert rig.conductor.snapshot().state == "idle"


def test_no_runs_at_all_is_no_order(rig: Any) -> None:
    with pytest.raises(InputError, match="runs is 0"):
        rig.conductor.arm("small", runs=0)


def test_a_second_arm_while_a_board_passes(rig: Any) -> None:
    grant = rig.arm(board_id="b 1")
    rig.begin(grant)
    rig.until("filming")
    with pytest.raises(StateError, match=r"The station is filming.*arm is not possible"):
        rig.conductor.arm("small", "b 2")
    rig.finish(grant, rig.row(grant, 0))
    assert rig.result_of(grant.run).board_id == "b 1"


def test_arming_before_the_cameras_are_open(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    with pytest.raises(StateError, match="The station is starting") as refusal:
        rig.conductor.arm("small")
    assert "Wait" in refusal.value.action


def test_a_camera_that_cannot_be_armed(rig: Any) -> None:
    refused: list[Exception] = []

    def arm() -> None:
        try:
            rig.conductor.arm("small")
        except DeviceError as error:
            refused.append(error)

    caller = threading.Thread(target=arm)
    caller.start()
    grant = rig.peer.expect(said.Grant)
    rig.peer.expect(said.Arm)
    rig.peer.say(said.Trouble("clock", "camera c1: its clock is not known", "Check its cable."))
    rig.peer.expect(said.Disarm)
    rig.peer.say(said.Disarmed((grant,)))
    caller.join(20)
    assert "its clock is not known" in str(refused[0])
    rig.until("idle")


def test_unknown_runs_and_frames(rig: Any) -> None:
    for ask in (rig.conductor.run, rig.conductor.release, rig.conductor.stitch, rig.conductor.components):
        with pytest.raises(NotFoundError, match="no run 'never'"):
            ask("never")
    with pytest.raises(NotFoundError, match="no run 'never'"):
        rig.conductor.hold("never", "me", "test")
    grant = rig.arm()
    rig.board(grant, rows=2)
    rig.result_of(grant.run)
    with pytest.raises(NotFoundError, match="2 cameras and 2 rows"):
        rig.conductor.frame(grant.run, 0, 7)
    with pytest.raises(NotFoundError, match="no component 'R99'"):
        rig.conductor.views(grant.run, "R99")


# --- memory


def test_frames_are_copies_of_the_ring_and_holes_are_refused(rig: Any) -> None:
    grant = rig.arm()
    rig.board(grant, rows=3, verdicts={0: Verdict.MISSING, 1: Verdict.INCOMPLETE})
    rig.result_of(grant.run)
    pixels, record = rig.conductor.frame(grant.run, 1, 2)
    assert record.verdict is Verdict.OK
    assert np.all(pixels == 10 + 20 + 2)
    pixels[:] = 0
    assert np.all(rig.conductor.frame(grant.run, 1, 2)[0] == 32)
    with pytest.raises(NotFoundError, match="never arrived: scripted"):
        rig.conductor.frame(grant.run, 0, 1)
    with pytest.raises(StateError, match="is incomplete: scripted"):
        rig.conductor.frame(grant.run, 1, 1)
    assert rig.conductor.frame(grant.run, 1, 1, allow_incomplete=True)[1].verdict is Verdict.INCOMPLETE


def test_frames_of_a_board_that_is_still_passing(rig: Any) -> None:
    grant = rig.arm()
    rig.begin(grant)
    rig.row(grant, 0)
    rig.wait_run(grant.run, lambda run: run.counts.ok == 2, "two frames")
    assert np.all(rig.conductor.frame(grant.run, 1, 0)[0] == 30)
    with pytest.raises(StateError, match="has not arrived yet"):
        rig.conductor.frame(grant.run, 0, 1)


def full(rig: Any) -> list[str]:
    """Film until every bay is held by tester 3."""
    runs, grant = [], rig.arm()
    for k in range(3):
        rig.begin(grant)
        rig.wait_run(grant.run, lambda run: run.state == "filming", "the board")
        rig.conductor.hold(grant.run, "tester 3", "AOI")
        rig.finish(grant, rig.row(grant, 0))
        rig.result_of(grant.run)
        runs.append(grant.run)
        if k < 2:
            grant = rig.peer.expect(said.Grant)
    rig.until("blocked")
    return runs


def test_a_full_ring_blocks_arming_names_the_holders_and_loses_nothing(rig: Any) -> None:
    runs = full(rig)
    snapshot = rig.conductor.snapshot()
    assert [lease.holder for lease in snapshot.ring.leases] == ["tester 3"] * 3
    assert [reason.code for reason in snapshot.reasons] == ["ring-full"]
    with pytest.raises(BusyError, match=rf"run {runs[0]} is held by tester 3 \(AOI\)"):
        rig.conductor.arm("small", "b 9")
    rig.peer.say(said.BoardMissed(time.monotonic(), "no memory was granted for it: all of it is in use"))
    rig.wait_for(lambda: rig.conductor.snapshot().boards_missed == 1, "a missed board")
    missed = [e for e in rig.conductor.events() if e.kind == "board-missed"]
    assert len(missed) == 1
    assert "held by tester 3" in missed[0].action
    assert all(rig.conductor.frame(run, 0, 0)[0].any() for run in runs)


def test_a_run_that_is_let_go_unblocks_the_line(rig: Any) -> None:
    runs = full(rig)
    rig.conductor.let_go(runs[1], "tester 3")
    grant = rig.peer.expect(said.Grant)
    rig.until("armed")
    assert rig.conductor.snapshot().reasons == ()
    with pytest.raises(GoneError, match="no longer in memory"):
        rig.conductor.frame(runs[1], 0, 0)
    assert rig.conductor.run(runs[1]).state == "gone"
    rig.board(grant)
    run = rig.result_of(grant.run)
    assert run.verdict is Status.OK
    assert run.state == "gone", "all others are held, so it makes room for the next board at once"


def test_a_released_run_keeps_its_result(rig: Any) -> None:
    runs = full(rig)
    assert rig.conductor.release(runs[2]).state == "released"
    rig.peer.expect(said.Grant)
    rig.until("armed")
    assert rig.conductor.release(runs[2]).state == "released"
    assert rig.conductor.stitch(runs[2]).status is Status.OK
    with pytest.raises(GoneError):
        rig.conductor.hold(runs[2], "me", "late")


def test_a_run_that_is_needed_is_not_released(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.begin(grant)
    rig.until("filming")
    with pytest.raises(StateError, match="its memory is needed"):
        rig.conductor.release(grant.run)


def test_pictures_are_rendered_under_a_lease(rig: Any) -> None:
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    [component] = rig.conductor.components(grant.run)
    assert component.address == "U1"
    assert component.tester_mm == (10.0, 20.0)
    views = rig.conductor.views(grant.run, "U1")
    assert views
    assert rig.conductor.image(grant.run, "U1", 0, format="jpeg") == b"picture"
    [job] = [job for job in rig.workers.done if isinstance(job, RenderJob)]
    assert (job.format, job.view.camera, job.view.row) == ("jpeg", views[0].camera, views[0].row)
    with pytest.raises(NotFoundError, match=f"has {len(views)} images"):
        rig.conductor.image(grant.run, "U1", 99)
    rig.wait_for(lambda: rig.conductor.snapshot().ring.leases == (), "the lease to end")
    rig.workers.keep = True
    drawing = threading.Thread(target=rig.conductor.image, args=(grant.run, "U1", 0))
    drawing.start()
    rig.wait_for(lambda: len(rig.workers.kept) == 1, "the job")
    [lease] = rig.conductor.snapshot().ring.leases
    assert (lease.run, lease.purpose) == (grant.run, "image U1/0")
    rig.workers.let_go()
    drawing.join(20)


# --- what dies


def test_acquisition_dies_in_mid_run_and_what_had_arrived_is_stitched(rig: Any) -> None:
    grant = rig.arm(board_id="b 1")
    rig.begin(grant)
    rig.peer.expect(said.Grant)
    rig.row(grant, 0)
    rig.row(grant, 1)
    rig.wait_run(grant.run, lambda run: run.counts.ok == 4, "four frames")
    rig.peer.say(said.PulseSeen(grant.run, Pulse(index=2, time_s=100.2)))
    rig.wait_run(grant.run, lambda run: run.rows == 3, "three rows")
    rig.peer.die()
    run = rig.result_of(grant.run)
    assert run.state == "degraded"
    assert run.verdict is Status.OK
    assert (run.counts.ok, run.counts.missing) == (4, 2)
    assert {reason.code for reason in run.reasons} == {"frames-missing", "acquisition-lost"}
    assert np.all(rig.conductor.frame(grant.run, 1, 1)[0] == 31)
    rig.peer.life(2)
    rig.peer.say(said.Ready(2))
    rearmed = rig.peer.expect(said.Grant)
    rig.peer.expect(said.Arm)
    rig.peer.say(said.Armed())
    rig.until("armed")
    rig.board(rearmed)
    assert rig.result_of(rearmed.run).board_id == "b 1"
    assert rig.link.status().restarts == 1


def test_acquisition_dies_before_the_first_pulse(rig: Any) -> None:
    grant = rig.arm()
    rig.begin(grant)
    rig.until("filming")
    rig.peer.die()
    run = rig.result_of(grant.run)
    assert (run.state, run.rows, run.timings) == ("failed", 0, None)
    with pytest.raises(NotFoundError, match="ended without a result: The acquisition process ended"):
        rig.conductor.stitch(grant.run)


def test_acquisition_dies_while_arming(rig: Any) -> None:
    refused: list[Exception] = []

    def arm() -> None:
        try:
            rig.conductor.arm("small")
        except DeviceError as error:
            refused.append(error)

    caller = threading.Thread(target=arm)
    caller.start()
    rig.peer.expect(said.Grant)
    rig.peer.die()
    caller.join(20)
    assert "Arming failed" in str(refused[0])
    assert rig.conductor.snapshot().state == "faulted"
    with pytest.raises(StateError, match="The station is faulted"):
        rig.conductor.arm("small")


def test_a_task_that_fails_degrades_and_one_that_kills_fails_the_run(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.board(grant, rows=2)
    rig.wait_run(grant.run, lambda run: run.state == "stitching", "stitching")
    job, done = rig.workers.kept.pop()
    done(Answer(None, InternalError("the link broke"), 0.0))
    rig.workers.let_go()
    run = rig.result_of(grant.run)
    assert run.state == "degraded"
    assert [r.message for r in run.reasons] == ["the link broke"]
    second = rig.peer.expect(said.Grant)
    rig.workers.keep = True
    rig.board(second, rows=2)
    rig.wait_run(second.run, lambda run: run.state == "stitching", "stitching")
    job, done = rig.workers.kept.pop()
    done(Answer(None, InternalError(f"{job} took 2 workers with it", code="worker-lost"), 0.0))
    run = rig.result_of(second.run)
    assert run.state == "failed"
    assert "took 2 workers with it" in run.reasons[0].message
    assert np.all(rig.conductor.frame(second.run, 0, 1)[0] == 11)


@pytest.mark.parametrize(("status", "state"), [(Status.DEGRADED, "degraded"), (Status.FAILED, "failed")])
def test_the_stitchs_verdict_is_the_runs(rig: Any, make_stitch: Callable[..., Any], status: Status, state: str) -> None:
    rig.workers.result = lambda head: make_stitch(head, status, ("two fiducials only",))
    grant = rig.arm()
    rig.board(grant)
    run = rig.result_of(grant.run)
    assert (run.state, run.verdict) == (state, status)
    assert run.reasons[0].message == "two fiducials only"
    assert rig.conductor.stitch(grant.run).status is status


# --- board types, health, the end


def test_board_types_are_taught_listed_and_forgotten(rig: Any, board_type: BoardType) -> None:
    other = board_type.model_copy(update={"name": "other/board"})
    assert rig.conductor.put_board_type(other) is True
    assert rig.conductor.put_board_type(other) is False
    (rig.config.board_types / "broken.json").write_text("{")
    listed = {entry.name: entry for entry in rig.conductor.board_types()}
    assert set(listed) == {"small", "other/board", "broken"}
    assert listed["broken"].fault is not None
    assert listed["other/board"].components == 1
    assert rig.conductor.board_type("other/board") == other
    rig.arm()
    with pytest.raises(StateError, match="armed for board type 'small'"):
        rig.conductor.delete_board_type("small")
    rig.conductor.delete_board_type("other/board")
    with pytest.raises(NotFoundError):
        rig.conductor.board_type("other/board")


def test_a_board_keeps_the_type_it_was_filmed_with(rig: Any, board_type: BoardType) -> None:
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    rig.conductor.put_board_type(board_type.model_copy(update={"components": ()}))
    assert len(rig.conductor.components(grant.run)) == 1


def test_health_is_shown(rig: Any) -> None:
    assert [c.connected for c in rig.conductor.snapshot().cameras] == [False, False]
    cameras = (CameraHealth(True, delivered=7, temperature_c=41.5), CameraHealth(False, "cable pulled"))
    rig.peer.say(said.Health(cameras, "controller fine", time.monotonic()))
    rig.wait_for(lambda: rig.conductor.snapshot().controller == "controller fine", "health")
    snapshot = rig.conductor.snapshot()
    assert snapshot.cameras[0].delivered == 7
    assert "c1 is not connected. cable pulled" in snapshot.reasons[0].message
    [acquisition] = snapshot.processes
    assert acquisition.heartbeat_age_s is not None


def test_a_trouble_is_told_once_and_shown_as_long_as_it_lasts(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    trouble = said.Trouble("device", "camera c1: does not answer", "Check its cable.")
    for _ in range(3):
        rig.peer.say(trouble)
    rig.peer.say(said.Health((), "after the troubles", time.monotonic()))
    rig.wait_for(lambda: rig.conductor.snapshot().controller == "after the troubles", "the troubles")
    [reason] = rig.conductor.snapshot().reasons
    assert (reason.code, reason.action) == ("device", "Check its cable.")
    assert len([e for e in rig.conductor.events() if e.kind == "trouble"]) == 1
    monkeypatch.setattr(reasons, "TROUBLE_S", 0.0)
    rig.wait_for(lambda: rig.conductor.snapshot().reasons == (), "the trouble to be over")


def test_the_end_waits_for_the_run_under_way(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.board(grant)
    rig.wait_run(grant.run, lambda run: run.state == "stitching", "stitching")
    ending = threading.Thread(target=rig.conductor.wind_down, args=(20.0,))
    ending.start()
    rig.until("stopping")
    assert rig.peer.expect(said.Grant)
    assert rig.peer.expect(said.Disarm)
    rig.workers.let_go()
    ending.join(20)
    assert rig.result_of(grant.run).state == "ready"
    with pytest.raises(StateError, match="stopping"):
        rig.conductor.arm("small")


def test_a_wind_down_does_not_wait_for_ever(rig: Any) -> None:
    rig.begin(rig.arm())
    rig.until("filming")
    rig.conductor.wind_down(0.05)
    assert rig.conductor.snapshot().state == "stopping"
