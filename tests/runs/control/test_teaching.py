"""Who may be a reference, and what becomes of references: on a scripted rig."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.errors import DeviceError, GoneError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.model import BoardType, RecordingHead, Status, Stitch, Verdict
from vaoi_station.runs.archive.measured_parts import DIRECTORY as GOOD_BOARDS
from vaoi_station.runs.archive.measured_parts import good_file


def taught(rig: Any) -> str:
    """Film a run and teach it as the reference; the line is idle again."""
    run = filmed(rig)
    assert rig.coordinator.teach_reference("small", run)
    return run


def filmed(rig: Any, verdicts: dict[int, Verdict] | None = None) -> str:
    grant = rig.arm(runs=1)
    rig.board(grant, verdicts=verdicts)
    run: str = rig.result_of(grant.run).id
    disarmed(rig)
    return run


def disarmed(rig: Any) -> None:
    from vaoi_station.acquisition.process import messages

    while not isinstance(rig.peer.connection.recv(), messages.Disarm):
        pass
    rig.peer.report(messages.Disarmed(()))
    rig.until("idle")


def kept(rig: Any) -> set[str]:
    return {path.name for path in (rig.config.data / "references").glob("*")}


def test_the_next_order_uses_the_reference_and_sends_its_directory_to_the_workers(rig: Any) -> None:
    run = taught(rig)
    grant = rig.arm()
    armed = rig.coordinator.snapshot().armed_with
    assert (armed.method, armed.reference) == ("auto", run)
    rig.board(grant)
    rig.result_of(grant.run)
    tasks = [task for task in rig.workers.tasks(grant.run) if task.kind == "reference"]
    assert {task.a for task in tasks} == rig.coordinator._make_order(
        rig.coordinator.board_type("small"), None, None
    ).reference.reference.present
    references = {opening.reference for opening in rig.workers.opened if opening.context.run == grant.run}
    assert references == {rig.config.data / "references" / run}


@pytest.mark.parametrize(
    ("status", "reasons"), [(Status.DEGRADED, ("the marks are pale",)), (Status.FAILED, ("no fiducials",))]
)
def test_a_run_that_is_not_ok_is_no_reference(
    rig: Any, make_stitch: Callable[..., Stitch], status: Status, reasons: tuple[str, ...]
) -> None:
    def weak(head: RecordingHead) -> Stitch:
        return make_stitch(head, status, reasons)

    rig.workers.result = weak
    run = filmed(rig)
    with pytest.raises(StateError, match=f"is {status} and cannot be a reference: {reasons[0]}") as refused:
        rig.coordinator.teach_reference("small", run)
    assert refused.value.code == "not-a-reference"
    assert kept(rig) == set()


def test_what_cannot_be_taught_is_refused_and_nothing_is_kept(rig: Any, board_type: BoardType) -> None:
    run = filmed(rig)
    rig.coordinator.put_board_type(board_type.model_copy(update={"name": "other"}))

    def refusal(board_type: str, run: str) -> VaoiError:
        with pytest.raises(VaoiError) as refused:
            rig.coordinator.teach_reference(board_type, run)
        return refused.value

    assert (type(e := refusal("small", "nosuch")), e.code) == (NotFoundError, "unknown-run")
    assert (type(e := refusal("nosuch", run)), e.code) == (NotFoundError, "unknown-board-type")
    assert (type(e := refusal("other", run)), e.code) == (InputError, "other-board-type")
    rig.coordinator.release(run)
    assert (type(e := refusal("small", run)), e.code) == (GoneError, "frames-gone")
    assert kept(rig) == set()
    with pytest.raises(NotFoundError, match="has no reference"):
        rig.coordinator.reference("small")
    with pytest.raises(NotFoundError, match="has no reference"):
        rig.coordinator.forget_reference("small")


def test_a_board_type_that_is_changed_later_is_stitched_without_its_reference(rig: Any, board_type: BoardType) -> None:
    run = taught(rig)
    rig.coordinator.put_board_type(board_type.model_copy(update={"y_axis": "down"}))
    status = rig.coordinator.reference("small")
    assert (status.run, status.usable) == (run, False)
    assert "had other y_axis" in status.fault.message
    grant = rig.arm()
    assert rig.coordinator.snapshot().armed_with.reference is None
    rig.board(grant)
    detail = rig.result_of(grant.run)
    assert detail.state == "ready"
    assert [r.code for r in detail.reasons] == ["reference-unusable"]
    assert not [task for task in rig.workers.tasks(grant.run) if task.kind == "reference"]


def test_a_disk_that_refuses_changes_nothing(rig: Any) -> None:
    run = filmed(rig)
    (rig.config.data / "references").write_text("in the way")
    with pytest.raises(DeviceError, match="cannot be written") as refused:
        rig.coordinator.teach_reference("small", run)
    assert "Check space" in refused.value.action
    with pytest.raises(NotFoundError):
        rig.coordinator.reference("small")


def test_good_boards_go_with_their_board_type_and_come_back_with_it(rig: Any) -> None:
    file = good_file(rig.config.data / GOOD_BOARDS, "small", "r1")
    file.parent.mkdir(parents=True)
    file.write_bytes(b"what a good board looks like")
    rig.coordinator.delete_board_type("small")
    assert rig.coordinator.parts.good("small").boards == ()
    with pytest.raises(NotFoundError):
        rig.coordinator.parts.forget("r1")
    rig.coordinator.board_type_history.restore("small", "latest")
    assert [good.run for good in rig.coordinator.parts.good("small").boards] == ["r1"]
