"""The verdict of a run, decided in one place from everything that is known of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.acquisition.pairing.proof import TriggerFinding, TriggerProof, doubts_of
from vaoi_station.model import Reason, Status, Stitch
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.run.verdict import conclude, decide_verdict

REASON = Reason("board-id-differs", "The code states 1, the line was armed with 2.")


def of_board(*, required: bool, state: Any = "differs") -> IdentityDocument:
    return IdentityDocument(state=state, required=required, reasons=(REASON,) if state == "differs" else ())


@pytest.mark.parametrize(
    ("result", "doubted", "identity", "status"),
    [
        (Status.OK, False, None, Status.OK),
        (Status.OK, True, None, Status.DEGRADED),
        (Status.OK, False, of_board(required=True), Status.DEGRADED),
        (Status.OK, False, of_board(required=True, state="not-read"), Status.DEGRADED),
        (Status.OK, False, of_board(required=True, state="pending"), Status.OK),
        (Status.OK, False, of_board(required=False), Status.OK),
        (Status.DEGRADED, False, None, Status.DEGRADED),
        (Status.FAILED, True, of_board(required=True), Status.FAILED),
        (None, False, None, Status.FAILED),
    ],
)
def test_verdict_is_the_worst_that_result_faults_doubts_and_identity_leave(
    result: Status | None, doubted: bool, identity: IdentityDocument | None, status: Status
) -> None:
    assert decide_verdict(result, (), doubted=doubted, identity=identity).status is status


def of_result(status: Status, findings: tuple[TriggerFinding, ...], doubts: tuple[str, ...], **result: Any) -> Any:
    """Return what `conclude` reads of a run that has ended."""
    proof = TriggerProof(proven=False, cameras=(), findings=findings) if findings else None
    doubts = doubts or doubts_of(proof)
    result["reasons"] = (*result.get("reasons", ()), *doubts)
    stitch = Stitch(method="auto", image_matrices=(()), cad_matrix=None, row_motion=(), status=status, **result)
    head, order = SimpleNamespace(doubts=doubts), SimpleNamespace(notes=())
    recorded = SimpleNamespace(head=head, proof=proof)
    return SimpleNamespace(
        stitch=stitch, recorded=recorded, head=head, state="ready", faults=[], frames={}, order=order
    )


def test_trigger_findings_are_reasons_with_camera_and_row() -> None:
    """Ignored triggers are missing frames, which have reasons of their own."""
    findings = (
        TriggerFinding(camera=2, row=None, kind="runs-freely", text="it sends a frame every 33.3 ms"),
        TriggerFinding(camera=0, row=4, kind="extra-frame", text="once more"),
        TriggerFinding(camera=0, row=5, kind="ignored-trigger", text="no answer"),
    )
    reasons = conclude(of_result(Status.DEGRADED, findings, ())).reasons
    assert [(r.code, r.message) for r in reasons] == [
        ("trigger-runs-freely", "Camera 2: it sends a frame every 33.3 ms. Its frames are not used."),
        ("trigger-extra-frame", "Camera 0, row 4: once more."),
    ]
    assert all(r.action for r in reasons)


def test_reasons_of_a_result_state_its_codes() -> None:
    finding = TriggerFinding(camera=0, row=4, kind="extra-frame", text="once more")
    coded = of_result(
        Status.FAILED, (finding,), (), reasons=("too dark",), reason_codes=("no-texture", "trigger-doubtful")
    )
    reason, of_proof = conclude(coded).reasons
    assert (reason.code, reason.cause, reason.message) == ("stitch-failed", "no-texture", "too dark")
    assert of_proof.code == "trigger-extra-frame"
    reason, _ = conclude(of_result(Status.FAILED, (finding,), (), reasons=("too dark",))).reasons
    assert reason.cause == "", "results of older versions have no codes"
