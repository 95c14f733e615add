"""The coordinator against a scripted acquisition process: the life of boards, and what goes wrong."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from vaoi_station.acquisition.process import messages
from vaoi_station.errors import StateError
from vaoi_station.model import Status
from vaoi_station.runs.control import reasons


def test_a_board_passes(rig: Any) -> None:
    grant = rig.arm(board_id="b 1", job_id="j 7")
    assert rig.coordinator.snapshot().state == "armed"
    rig.board(grant, rows=3)
    run = rig.result_of(grant.run)
    assert (run.id, run.state, run.verdict) == (grant.run, "ready", Status.OK)
    assert (run.board_type, run.board_id, run.job_id) == ("small", "b 1", "j 7")
    assert (run.rows, run.counts.ok, run.counts.missing, run.ended) == (3, 6, 0, "clear")
    assert run.belt is not None
    assert run.belt.ratio == pytest.approx(1.01)
    assert run.timings is not None
    assert run.timings.links == len(rig.workers.tasks(grant.run)) == len(rig.coordinator.timeline(grant.run).tasks)
    assert run.timings.ready_after_last_frame_ms > 0
    assert rig.coordinator.stitch(grant.run).status is Status.OK
    assert rig.coordinator.next_run(None, 0.0) is None
    assert rig.workers.closed == [grant.run]


def test_every_finished_run_is_returned_once_and_in_order(rig: Any) -> None:
    assert rig.coordinator.latest() is None
    got: list[str] = []
    listening = threading.Event()

    def follow() -> None:
        listening.set()
        first = rig.coordinator.next_run(None, 20.0)
        while first is not None and len(got) < 3:
            got.append(first.id)
            first = rig.coordinator.next_run(first.id, 20.0)

    follower = threading.Thread(target=follow)
    follower.start()
    assert listening.wait(10)
    grant, expected = rig.arm(), []
    for _ in range(4):
        rig.board(grant, rows=2)
        rig.result_of(grant.run)
        expected.append(grant.run)
        grant = rig.peer.expect(messages.Grant)
    follower.join(20)
    assert got in (expected[:3], expected[1:4])
    assert rig.coordinator.next_run(expected[-1], 0.01) is None
    assert rig.coordinator.next_run(expected[0], 0.0).id == expected[1]


# --- ids, and how long they hold


# --- board types, health, the end


def test_a_trouble_is_published_once_and_shown_while_it_lasts(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    trouble = messages.Trouble("device", "camera c1: does not answer", "Check its cable.")
    for _ in range(3):
        rig.peer.report(trouble)
    rig.peer.report(messages.Health((), "after the troubles", time.monotonic()))
    rig.wait_for(lambda: rig.coordinator.snapshot().controller == "after the troubles", "the troubles")
    [reason] = rig.coordinator.snapshot().reasons
    assert (reason.code, reason.action) == ("device", "Check its cable.")
    assert len([e for e in rig.coordinator.events() if e.kind == "trouble"]) == 1
    monkeypatch.setattr(reasons, "TROUBLE_S", 0.0)
    rig.wait_for(lambda: rig.coordinator.snapshot().reasons == (), "the trouble to be over")


def test_the_end_waits_for_the_run_under_way(rig: Any) -> None:
    rig.workers.keep = True
    grant = rig.arm()
    rig.board(grant)
    rig.wait_run(grant.run, lambda run: run.state == "stitching", "stitching")
    ending = threading.Thread(target=rig.coordinator.wind_down, args=(20.0,))
    ending.start()
    rig.until("stopping")
    assert rig.peer.expect(messages.Grant)
    assert rig.peer.expect(messages.Disarm)
    rig.workers.perform_kept()
    ending.join(20)
    assert rig.result_of(grant.run).state == "ready"
    with pytest.raises(StateError, match="stopping"):
        rig.coordinator.arm("small")


def test_an_armed_line_keeps_its_board_type_when_it_is_replaced(rig: Any) -> None:
    grant = rig.arm()
    old = rig.coordinator.board_type("small")
    rig.coordinator.put_board_type(old.model_copy(update={"components": ()}))
    assert rig.coordinator.events(0)[-1].message.endswith("was replaced. The change applies from the next arming on.")
    rig.board(grant)
    rig.result_of(grant.run)
    assert [c.address for c in rig.coordinator.components(grant.run)] == ["U1"]
