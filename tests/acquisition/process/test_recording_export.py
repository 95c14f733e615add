"""Tests of the export of runs, from packed frames too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.process.filming import export_run, recording_head
from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout
from vaoi_station.model import CameraHead, FrameRecord, RecordingHead, Verdict
from vaoi_station.pixel_formats import PIXEL_FORMATS, picture

WIDTH, HEIGHT = 18, 16


@pytest.mark.parametrize("names", [("Mono12p", "BayerRG8"), ("Mono10Packed", "BayerGB12p")])
def test_a_recording_holds_pictures_of_packed_frames(tmp_path: Path, names: tuple[str, str]) -> None:
    """Recordings hold 16 bit grey or colour pictures, whatever the cameras send."""
    layout = RingLayout(1, 1, tuple(FrameShape(WIDTH, HEIGHT, name) for name in names))
    with Ring.create(tmp_path / "packed.ring", layout) as ring, Ring.attach(ring.path) as reader:
        generation = ring.claim(0)
        sent = [
            np.random.default_rng(k).integers(0, 256, PIXEL_FORMATS[name].nbytes(WIDTH, HEIGHT), dtype=np.uint8)
            for k, name in enumerate(names)
        ]
        for camera, frame in enumerate(sent):
            ring.memory(camera)[:] = frame
        frames = tuple(FrameRecord(camera=k, row=0, verdict=Verdict.OK, slot=k) for k in range(2))
        head = RecordingHead(
            format="vaoi-recording",
            version=1,
            cameras=(CameraHead(width=WIDTH, height=HEIGHT, exposure_us=250.0),) * 2,
            rows=1,
            trigger_period_s=0.1,
            conveyor_mm_s=(0.0, 100.0),
        )
        finished = RunFinished("001", 0, head, frames, 0.0, "clear")
        recording = export_run(tmp_path / "kept", finished, reader, generation)
        for camera, (frame, name) in enumerate(zip(sent, names, strict=True)):
            seen = picture(frame, WIDTH, HEIGHT, PIXEL_FORMATS[name])
            assert (reader.frame(camera) == seen).all()
            kept = recording.frame(camera, 0)
            assert kept is not None
            assert kept.dtype == seen.dtype
            assert (kept == seen).all()


def test_the_head_has_the_verdicts_and_the_proof_in_keys_of_its_own() -> None:
    camera = CameraHead(width=WIDTH, height=HEIGHT, exposure_us=250.0)
    head = RecordingHead(
        format="vaoi-recording",
        version=1,
        cameras=(camera,),
        rows=2,
        trigger_period_s=0.1,
        conveyor_mm_s=(0.0, 100.0),
        missing=((0, 1),),
    )
    frames = (
        FrameRecord(camera=0, row=0, verdict=Verdict.OK, slot=0),
        FrameRecord(camera=0, row=1, verdict=Verdict.MISSING, cause="the camera did not expose"),
    )
    proof = TriggerProof(proven=True, cameras=(), findings=())
    written = recording_head(RunFinished("r7", 0, head, frames, 0.0, "max-rows", proof=proof))
    assert written.missing == head.missing
    extra = written.model_extra or {}
    assert (extra["x_run"], extra["x_ended"]) == ("r7", "max-rows")
    assert extra["x_verdicts"] == [{"camera": 0, "row": 1, "verdict": "missing", "cause": "the camera did not expose"}]
    assert TriggerProof.model_validate(extra["x_proof"]) == proof
    assert "x_proof" not in (recording_head(RunFinished("r7", 0, head, frames, 0.0, "clear")).model_extra or {})
