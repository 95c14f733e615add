from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from vaoi_station.simulation import Twin
from vaoi_station.simulation.imaging.scene import Scene

Make = Callable[..., Twin]


def test_frames_do_not_depend_on_what_was_asked_before(small: Twin) -> None:
    fresh = Twin(small.scenario)
    last = fresh.passage(1).frame(1, 3)
    small.passage(0).frame(0, 0)
    ordered = small.passage(1).render_all()
    assert np.array_equal(ordered[1, 3], last)
    assert ordered[0, 0].shape == (480, 640)
    assert ordered[0, 0].dtype == np.uint8


def test_only_bodies_far_off_are_left_out_beforehand(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    board = {"width_mm": 90.0, "length_mm": 70.0, "density": 2.0, "height_scale": 2.0, "lift_mm": 3.0, "turned_deg": 90}
    twin = make(array={"cameras": 2, "tilt_deg": 3.0}, board=board)
    some = [twin.passage(0).frame(camera, row) for camera in (0, 1) for row in (0, 2)]
    near = twin.scene._nearby_bodies(twin.pinholes[0], twin.passage(0).pose(twin.passage(0).pulse_times_s[2]))
    assert 0 < len(near) < len(twin.artwork.bodies)
    monkeypatch.setattr(Scene, "_nearby_bodies", lambda scene, camera, pose: list(range(len(scene.artwork.bodies))))
    looked_at_all = [twin.passage(0).frame(camera, row) for camera in (0, 1) for row in (0, 2)]
    assert all(np.array_equal(a, b) for a, b in zip(some, looked_at_all, strict=True))


def test_a_board_too_long_for_one_texture_looks_like_any(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = make(board={"density": 2.0}, array={"cameras": 2, "tilt_deg": 1.0})
    whole = [twin.passage(0).frame(camera, row).astype(int) for camera in (0, 1) for row in range(4)]
    monkeypatch.setattr("vaoi_station.simulation.imaging.scene._MAX_REMAP_PX", 16)
    parts = [twin.passage(0).frame(camera, row).astype(int) for camera in (0, 1) for row in range(4)]
    for a, b in zip(whole, parts, strict=True):
        assert np.abs(a - b).mean() < 0.02, "but for the rounding of large coordinates"
        assert np.abs(a - b).max() <= 3


def test_boards_cameras_and_rows_have_noise_of_their_own(make: Make) -> None:
    twin = make(array={"read_noise": 2.0, "cameras": 2})
    empty = {(k, c): twin.passage(k).frame_at(c, -5.0, "ring", 0).astype(int) for k in (0, 1) for c in (0, 1)}
    later = twin.passage(0).frame_at(0, -5.0, "ring", 1).astype(int)
    pictures = [*empty.values(), later]
    for n, a in enumerate(pictures):
        for b in pictures[n + 1 :]:
            assert abs(float(np.corrcoef(a.ravel(), b.ravel())[0, 1])) < 0.05


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


def test_exposures_go_round_the_cameras(make: Make) -> None:
    twin, plain = make(array={"cameras": 3, "exposures_us": [1.0, 0.5]}), make(array={"cameras": 3})
    assert [h.exposure_us for h in twin.heads] == [1.0, 0.5, 1.0]
    for camera, factor in enumerate((1.0, 0.5, 1.0)):
        seen, full = (t.passage(0).frame(camera, 2).astype(float) for t in (twin, plain))
        assert np.abs(seen - factor * full).max() <= 1.0


def test_a_photograph_serves_as_texture(make: Make, tmp_path: Path) -> None:
    picture = np.zeros((400, 600, 3), np.uint8)
    picture[:, 300:] = 200
    cv2.imwrite(str(tmp_path / "photo.png"), picture)
    twin = make(board={"photograph": tmp_path / "photo.png"}, array={"roll_deg": 0.0, "position_mm": 0.0})
    frame = twin.passage(0).frame(0, 2)
    assert frame[60, 20] < 5
    assert frame[60, 140] > 190
    place = twin.passage(0).pose(twin.passage(0).pulse_times_s[2]) @ [15.0, 10.0, 1.0]
    edge = twin.pinholes[0].project(place[None, :2], 0.0)[0, 0]
    seen = np.interp(100, frame[60].astype(float), np.arange(160))
    assert abs(seen - edge) < 1.0


def test_the_board_s_parts_are_set_anew_for_every_board(small: Twin) -> None:
    first, again, other = (small.passage(k).placements for k in (4, 4, 5))
    assert first == again
    assert first != other
