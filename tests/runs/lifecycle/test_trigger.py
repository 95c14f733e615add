"""A run whose trigger proof fails: no caller gets an ok verdict, or a picture from an unproven frame."""

from __future__ import annotations

from typing import Any

import pytest

from tests.runs.conftest import a_stitch
from vaoi_station.acquisition.pairing.proof import CameraProof, TriggerFinding, TriggerProof
from vaoi_station.acquisition.process import messages
from vaoi_station.errors import StateError
from vaoi_station.model import RecordingHead, Status, Stitch

FREE = TriggerFinding(camera=1, row=None, kind="runs-freely", text="it sends a frame every 33.3 ms")


def proof_of(*findings: TriggerFinding) -> TriggerProof:
    figures = {"pulses": 3, "frames": 3, "extra": 0, "max_residual_us": 1.0, "latency_us": 7.0}
    cameras = tuple(CameraProof(camera=c, proven=FREE not in findings or c == 0, **figures) for c in (0, 1))
    return TriggerProof(proven=FREE not in findings, cameras=cameras, findings=findings)


def film(rig: Any, *findings: TriggerFinding, grant: messages.Grant | None = None) -> Any:
    """Film a board with these findings; return its run. Without a grant the line is armed first."""
    grant = grant or rig.arm()
    rig.begin(grant)
    records = [record for row in range(3) for record in rig.row(grant, row)]
    if FREE in findings:
        records = [r.model_copy(update={"proven": False, "cause": FREE.text}) if r.camera == 1 else r for r in records]
    rig.finish(grant, records, proof=proof_of(*findings))
    return rig.result_of(grant.run)


def test_a_free_running_camera_makes_the_run_degraded_and_its_frames_are_not_used(rig: Any) -> None:
    present: list[RecordingHead] = []

    def conclude(head: RecordingHead) -> Stitch:
        present.append(head)
        return a_stitch(head)

    rig.workers.result = conclude
    run = film(rig, FREE)
    assert (run.state, run.verdict) == ("degraded", Status.DEGRADED)
    assert (run.counts.ok, run.counts.unproven) == (3, 3)
    assert set(present[0].missing) == {(1, 0), (1, 1), (1, 2)}
    (reason,) = [r for r in run.reasons if r.code == "trigger-runs-freely"]
    assert reason.message == "Camera 1: it sends a frame every 33.3 ms. Its frames are not used."
    assert "vaoi doctor" in reason.action
    assert {choice.view.camera for choice in rig.coordinator.images(run.id, "U1").chosen} <= {0}
    with pytest.raises(StateError, match="may show another row: it sends a frame every") as refusal:
        rig.coordinator.frame(run.id, 1, 0)
    assert refusal.value.code == "frame-unproven"
    assert not rig.coordinator.frame(run.id, 1, 0, allow_incomplete=True)[1].proven


def test_the_station_warns_until_the_frames_match_their_pulses_again(rig: Any) -> None:
    film(rig, FREE)
    following = rig.peer.expect(messages.Grant)
    (warning,) = rig.coordinator.snapshot().warnings
    assert warning.code == "trigger-runs-freely"
    assert warning.message.startswith("Camera c1, run ")
    troubles = [e for e in rig.coordinator.events(0, 0.0) if e.kind == "trouble"]
    assert [(e.code, e.action != "") for e in troubles] == [("trigger-runs-freely", True)]
    film(rig, grant=following)
    assert rig.coordinator.snapshot().warnings == ()
    assert "Camera c1: its frames match the pulses again." in [e.message for e in rig.coordinator.events(0, 0.0)]
