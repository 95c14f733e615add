"""Tests of the messages: every command and report passes through a pipe unchanged."""

from __future__ import annotations

import multiprocessing
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraExposure, CameraHealth
from vaoi_station.acquisition.controller.interface import Permit, TriggerPlan
from vaoi_station.acquisition.process import messages
from vaoi_station.model import CameraHead, FrameRecord, Pulse, RecordingHead, Verdict

FRAME = FrameRecord(camera=0, row=2, verdict=Verdict.MISSING, cause="the camera sent no frame in this run")
HEAD = RecordingHead(
    format="vaoi-recording",
    version=1,
    cameras=(CameraHead(width=48, height=32, exposure_us=250.0),),
    rows=3,
    trigger_period_s=0.1,
    conveyor_mm_s=(0.0, 100.0),
)
EXAMPLES: list[Any] = [
    messages.Grant("r1", 2),
    messages.Arm(TriggerPlan(0.1, 0.1, 0.2, 5, 0.001)),
    messages.Disarm(),
    messages.PermitBoard(Permit(1, 20.0)),
    messages.FireOne(),
    messages.FireTrial(messages.Grant("trial-1", 0), (CameraExposure((200.0,), 6.0),), "ring", 80.0),
    messages.EndTrial(),
    messages.Shutdown(),
    messages.Ready(2),
    messages.Armed(),
    messages.Disarmed((messages.Grant("r2", 0),)),
    messages.RunStarted("r1", 2, 17.5),
    messages.PulseReported("r1", Pulse(index=1, time_s=3.5, light="ring")),
    messages.FrameSettled("r1", FRAME, 18.0),
    messages.RunFinished("r1", 2, HEAD, (FRAME,), 18.0, "clear"),
    messages.BoardMissed(19.0, "no pulse was fired"),
    messages.MissedPassage(19.0, ((0.0, 0.5), (0.9, None))),
    messages.Health((CameraHealth(True),), "idle", 20.0),
    messages.Trouble("camera-lost", "camera c0: is lost.", "Check its cable."),
    messages.TrialFailed("trial-1", messages.Trouble("device", "the port is gone.", "Plug it in.")),
]


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda m: type(m).__name__)
def test_a_message_passes_through_a_pipe_unchanged(message: Any) -> None:
    here, there = multiprocessing.Pipe()
    with here, there:
        here.send(message)
        assert there.recv() == message
