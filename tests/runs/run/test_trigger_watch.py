"""Tests of the watch of the trigger proofs."""

from __future__ import annotations

from tests.runs.conftest import a_head
from vaoi_station.acquisition.pairing.proof import CameraProof, Kind, TriggerFinding, TriggerProof
from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.runs.run.trigger_watch import TriggerWatch


def finished(run: str, *findings: tuple[int, Kind], frames: int = 3) -> RunFinished:
    found = tuple(TriggerFinding(camera=c, row=None, kind=k, text="its reason") for c, k in findings)
    figures = {"pulses": 3, "frames": frames, "extra": 0, "max_residual_us": 1.0, "latency_us": 7.0}
    cameras = tuple(CameraProof(camera=c, proven=not findings, **figures) for c in (0, 1))
    proof = TriggerProof(proven=not findings, cameras=cameras, findings=found)
    return RunFinished(run, 0, a_head(3), (), 0.0, "clear", proof=proof)


def test_a_doubt_is_a_warning_with_camera_run_and_action_until_a_run_without_it() -> None:
    watch = TriggerWatch(["camera left", "right"])
    begun, ended = watch.add(finished("r1", (0, "runs-freely")))
    assert [(r.code, r.message) for r in begun] == [("trigger-runs-freely", "Camera left, run r1: its reason.")]
    assert begun[0].action
    assert watch.warnings() == begun
    assert not ended
    assert watch.add(finished("r2")) == ((), ("camera left",))
    assert watch.warnings() == ()


def test_a_doubt_that_stays_is_one_warning_of_the_newest_run() -> None:
    watch = TriggerWatch(["left", "right"])
    watch.add(finished("r1", (1, "off-beat")))
    assert watch.add(finished("r2", (1, "off-beat"))) == ((), ())
    assert [r.message for r in watch.warnings()] == ["Right, run r2: its reason."]
    begun, _ = watch.add(finished("r3", (1, "runs-freely")))
    assert [r.code for r in begun] == ["trigger-runs-freely"]


def test_a_missing_frame_is_no_doubt_and_no_frame_ends_none() -> None:
    watch = TriggerWatch(["left", "right"])
    assert watch.add(finished("r1", (0, "ignored-trigger"))) == ((), ())
    watch.add(finished("r2", (0, "extra-frame")))
    watch.add(finished("r3", frames=0))
    assert [r.code for r in watch.warnings()] == ["trigger-extra-frame"]


def test_a_run_without_a_proof_changes_nothing() -> None:
    watch = TriggerWatch(["left", "right"])
    assert watch.add(RunFinished("r1", 0, a_head(3), (), 0.0, "acquisition lost")) == ((), ())
