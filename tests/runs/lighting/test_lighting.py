"""Settings on trial reach the acquisition process, and the frame of the camera comes back; no run is made of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.runs.conftest import a_head
from vaoi_station.acquisition.cameras.interface import CameraExposure, CameraHealth, CameraLimits
from vaoi_station.acquisition.process import messages
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.model import FrameRecord, Verdict
from vaoi_station.runs.lighting import trials
from vaoi_station.runs.lighting.trials import TrialSettings


def shot(rig: Any, verdict: Verdict = Verdict.OK, cause: str = "") -> messages.FireTrial:
    """Play the acquisition process for one pulse: camera 1 delivers a frame of 77, or loses it."""
    fired: messages.FireTrial = rig.peer.expect(messages.FireTrial)
    run, bay = fired.grant.run, fired.grant.bay
    slot = rig.ring.slot(bay, 1, 0)
    rig.ring.memory(slot)[:] = 77
    kept = slot if verdict is Verdict.OK else None
    frame = FrameRecord(camera=1, row=0, verdict=verdict, cause=cause, slot=kept)
    rig.peer.report(
        messages.RunStarted(run, bay, 1.0),
        messages.FrameSettled(run, frame, 1.0),
        messages.RunFinished(run, bay, a_head(1), (frame,), 1.0, "single"),
    )
    return fired


def test_a_trial_gives_the_frame_of_its_camera_and_leaves_nothing_behind(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.ready()
    lighting = rig.coordinator.lighting
    with ThreadPoolExecutor(1) as caller:
        outcome = caller.submit(lighting.try_settings, 1, TrialSettings(exposure_us=400.0, gain_db=6.0))
        fired = shot(rig)
        taken = outcome.result(10)
        assert fired.exposures == (CameraExposure((100.0,), 0.0), CameraExposure((400.0,), 6.0))
        assert (taken.exposure_us, taken.gain_db, int(taken.pixels.min()), int(taken.pixels.max())) == (400, 6, 77, 77)
        assert rig.coordinator.runs() == ()
        assert rig.coordinator.snapshot().state == "idle"
        outcome = caller.submit(lighting.try_settings, 1, TrialSettings())
        shot(rig, Verdict.MISSING, "cable")
        with pytest.raises(DeviceError, match="camera c1: no frame \\(cable\\)"):
            outcome.result(10)
        lighting.end_trial()
        assert rig.peer.expect(messages.EndTrial)
        assert all(bay.use == "free" for bay in rig.coordinator.snapshot().ring.bays)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(trials, "SHOT_S", 0.01)
            with pytest.raises(DeviceError, match=r"gave no frames within 0\.01 s"):
                lighting.try_settings(1, TrialSettings())
        shot(rig)
        rig.wait_for(lambda: all(bay.use == "free" for bay in rig.coordinator.snapshot().ring.bays), "its end")
        outcome = caller.submit(lighting.try_settings, 1, TrialSettings())
        shot(rig)
        assert outcome.result(10).light == taken.light
        lighting.end_trial()
        assert rig.peer.expect(messages.EndTrial)
        with pytest.raises(NotFoundError, match="There is no camera 2"):
            lighting.try_settings(2, TrialSettings())
        with pytest.raises(
            InputError, match=r"exposure_us is 900000\.0, but must be at most 100000 µs, the trigger period of the line"
        ):
            lighting.try_settings(1, TrialSettings(exposure_us=900_000.0))
        limits = CameraLimits((10.0, 5000.0), (0.0, 0.0))
        health = messages.Health((CameraHealth(True), CameraHealth(True, limits=limits)), "", 1.0)
        rig.peer.report(health)
        core = rig.coordinator._core
        rig.wait_for(lambda: rig.coordinator._inbox.ask(core.devices) == health, "the limits of the cameras")
        for settings, wrong in (
            (TrialSettings(gain_db=6.0), "gain_db is 6.0"),
            (TrialSettings(exposure_us=9000.0), "exposure_us is 9000.0"),
        ):
            with pytest.raises(InputError, match=f"trial: {wrong}, but must be .*, the limits that camera c1 states"):
                lighting.try_settings(1, settings)
        rig.arm()
        with pytest.raises(StateError, match="The line is armed"):
            lighting.try_settings(1, TrialSettings())
