from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.simulation import Scenario, Twin

Make = Callable[..., Twin]


def test_frames_do_not_depend_on_earlier_requests(small: Twin) -> None:
    fresh = Twin(small.scenario)
    last = fresh.passage(1).frame(1, 3)
    small.passage(0).frame(0, 0)
    ordered = small.passage(1).render_all()
    assert np.array_equal(ordered[1, 3], last)
    assert ordered[0, 0].shape == (480, 640)
    assert ordered[0, 0].dtype == np.uint8


def test_a_texture_too_long_for_opencv_gives_the_same_frames(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = make(board={"density": 2.0}, array={"cameras": 2, "tilt_deg": 1.0})
    whole = [twin.passage(0).frame(camera, row).astype(int) for camera in (0, 1) for row in range(4)]
    monkeypatch.setattr("vaoi_station.simulation.imaging.scene.MAX_REMAP_PX", 16)
    parts = [twin.passage(0).frame(camera, row).astype(int) for camera in (0, 1) for row in range(4)]
    for a, b in zip(whole, parts, strict=True):
        assert np.abs(a - b).mean() < 0.02, "but for the rounding of large coordinates"
        assert np.abs(a - b).max() <= 3


def test_lights_take_turns_and_differ(make: Make) -> None:
    twin = make(
        line={"lights": ["bright", "dark"]},
        lights={"bright": {"gain": [1.0]}, "dark": {"gain": [0.5], "metal": 0.2}},
    )
    passage = twin.passage(0)
    assert passage.lights[:3] == ("bright", "dark", "bright")
    t = passage.pulse_times_s[1]
    bright, dark = (passage.frame_at(0, t, name, 0).astype(float) for name in ("bright", "dark"))
    assert abs(float(np.median(dark / np.maximum(bright, 1))) - 0.5) < 0.03


def test_a_longer_exposure_is_brighter_and_longer_blurred(make: Make) -> None:
    board = {"fiducials": [{"x_mm": 15.0, "y_mm": 10.0, "diameter_mm": 2.0}]}
    frames = []
    for factor in (1.0, 2.0):
        exposure = {"exposures_us": [3000.0 * factor], "reference_exposure_us": 6000.0, "bits": 16}
        passage = make(array=exposure, board=board, line={"period_s": 0.05}).passage(0)
        row = min(
            range(passage.rows), key=lambda r: abs(float((passage.pose(passage.pulse_times_s[r]) @ [15, 10, 1])[1]))
        )
        frames.append(passage.frame(0, row).astype(float) / 256)
    short, long = frames
    assert long.mean() == pytest.approx(2 * short.mean(), rel=0.01)
    sharpness = [float(np.abs(np.diff(f, axis=0)).max() / f.mean()) for f in frames]
    assert sharpness[1] < 0.8 * sharpness[0]


def test_a_program_sets_light_exposure_and_gain_of_each_row(make: Make) -> None:
    lit: dict[str, dict[str, float]] = {"ring": {}, "low": {}}
    bright = {"light": "low", "exposure_us": 125.0, "gain_db": 6.0206}
    steps = [{"light": "ring"}, {"light": "low", "on_us": 50.0}, bright]
    array = {"exposures_us": [250.0], "reference_exposure_us": 250.0}
    plain = make(array=array, lights=lit, line={"lights": ["ring"]}).scenario
    twin = Twin(Scenario.model_validate({**plain.model_dump(), "program": steps}))
    passage = twin.passage(0)
    head = passage.head()
    assert head.lights is not None
    assert head.lights[:4] == ("ring", "low", "low", "ring")
    assert [head.exposure_us(0, row) for row in range(3)] == [250.0, 50.0, 125.0]
    assert [head.gain(0, row) for row in range(3)] == [1.0, 1.0, pytest.approx(2.0, abs=1e-5)]
    time_s = passage.pulse_times_s[2]
    means = [passage.frame_at(0, time_s, "ring", 2, row).mean() for row in twin.program]
    assert means[1] / means[0] == pytest.approx(0.2, abs=0.01)
    assert means[2] / means[0] == pytest.approx(1.0, abs=0.01)
