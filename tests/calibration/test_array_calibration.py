from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vaoi_station.calibration import Outcome, calibrate
from vaoi_station.errors import InputError
from vaoi_station.files import write_recording
from vaoi_station.files.calibrations import Layout
from vaoi_station.model import RecordingHead


def _moved(layout: Layout, change: Callable[[Any], Any]) -> Layout:
    """A layout with other places: `change` takes and gives (k, 2)."""
    places = change(np.array([(m.x, m.y) for m in layout.marks]))
    marks = [{"x": float(x), "y": float(y)} for x, y in places]
    return Layout.model_validate(layout.model_dump() | {"marks": marks})


def _refused(outcome: Outcome) -> str:
    assert outcome.refused
    with pytest.raises(InputError) as caught:
        outcome.calibration()
    assert caught.value.code == "not-calibrated"
    return str(caught.value)


def test_every_camera_is_right_over_its_whole_frame(rig: Any) -> None:
    outcome = rig.calibrate(working_distance_mm=300.0)
    calibration = outcome.calibration()
    assert max(rig.errors_px(calibration)) < 0.015
    assert calibration.working_distance_mm == 300
    assert calibration.covariance is not None
    assert calibration.covariance[1].shape == (9, 9)
    assert calibration.principal_point == ((239.5, 179.5),) * 2
    assert calibration.residual_px is not None
    assert max(calibration.residual_px) < 0.02
    assert np.array(calibration.covariances[0]).shape == (9, 9)
    assert calibration.created is not None
    assert outcome.notes == ()


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10_000), distortion_px=st.sampled_from([0.0, 0.8]), turned=st.floats(0, 2))
def test_cameras_off_their_nominal_position_are_calibrated(
    film: Any, seed: int, distortion_px: float, turned: float
) -> None:
    rig = film(seed, shift_mm=1.0, roll_deg=turned, distortion_px=distortion_px, cameras=1)
    outcome = rig.calibrate()
    assert max(rig.errors_px(outcome.calibration())) < 0.04
    assert outcome.cameras[0].fit is not None
    bent, sigma = outcome.cameras[0].fit.lens_px
    assert abs(bent + distortion_px) < 4 * sigma


@pytest.mark.parametrize("bits", [12, 16])
def test_frames_of_more_bits_calibrate_as_those_of_8_bits(rig: Any, bits: int, tmp_path: Path) -> None:
    """A dark frame beside one with glare: the scale is that of the recording, not that of each frame."""
    cameras = [head.model_copy(update={"bits": bits}) for head in rig.heads]
    head = RecordingHead(
        format="vaoi-recording", version=1, rows=1, trigger_period_s=0.1, conveyor_mm_s=(0, 100), cameras=tuple(cameras)
    )
    frames = [np.asarray(f * (0.3 if k else 1.0), np.uint8) for k, f in enumerate(rig.frames)]
    frames[0][:60, :60] = 255
    deep = [(k, 0, frame.astype(np.uint16) << bits - 8) for k, frame in enumerate(frames)]
    recording = write_recording(tmp_path / "deep", head, deep)
    plain = rig.calibrate(change=lambda k, _: frames[k])
    found = calibrate(rig.heads, lambda k: recording.frame(k, 0), rig.layout)
    for one, other in zip(found.cameras, plain.cameras, strict=True):
        assert np.array_equal(one.detected.px, other.detected.px)
        assert one.detected.contrast == other.detected.contrast
    assert found.calibration().cameras(rig.heads)[1].ground((0.0, 0.0)) == pytest.approx(
        plain.calibration().cameras(rig.heads)[1].ground((0.0, 0.0))
    )


def test_a_covered_mark_is_reported_and_the_others_suffice(rig: Any) -> None:
    x, y = np.round(rig.seen_at(1, rig.in_view(1)[4])).astype(int)

    def cover(camera: int, frame: Any) -> Any:
        if camera == 1:
            frame[y - 20 : y + 20, x - 20 : x + 20] = 180
        return frame

    outcome = rig.calibrate(change=cover)
    assert max(rig.errors_px(outcome.calibration())) < 0.015
    (note,) = outcome.notes
    assert note.startswith("camera 1: the mark expected at")
    assert "not used" in note


def test_too_few_marks_are_refused_by_camera_and_number(rig: Any) -> None:
    def cover(camera: int, frame: Any) -> Any:
        for k in rig.in_view(0)[3:] if camera == 0 else ():
            x, y = np.round(rig.seen_at(0, k)).astype(int)
            frame[y - 20 : y + 20, x - 20 : x + 20] = 180
        return frame

    said = _refused(rig.calibrate(change=cover))
    assert "camera 0: it shows 3 marks" in said
    assert "at least 4 are needed" in said
    assert "camera 1" not in said


@pytest.mark.parametrize(
    ("way", "name"),
    [
        ((-1, 1), "mirrored in x"),
        ((1, -1), "mirrored in y"),
        ((-1, -1), "turned by 180°"),
    ],
)
def test_a_mirrored_or_turned_layout_is_refused_by_name(rig: Any, way: tuple[int, int], name: str) -> None:
    said = _refused(rig.calibrate(layout=_moved(rig.layout, lambda p: p * way)))
    assert f"The marks fit the layout {name}" in said


def test_another_boards_layout_is_refused(rig: Any) -> None:
    g = np.random.default_rng(4)
    off = _moved(rig.layout, lambda p: p + g.normal(0, 0.1, p.shape))
    said = _refused(rig.calibrate(layout=off))
    assert "residuals are" in said
    assert "the limit is 0.20 px" in said
    assert "layout.json belongs to this board" in said
    assert not rig.calibrate(layout=off, residual_px=50.0).cameras[0].refusal
    _refused(rig.calibrate(layout=_moved(rig.layout, lambda p: p * 1.3)))


def test_a_wrong_unit_and_a_wrong_polarity_are_named(rig: Any) -> None:
    inches = Layout.model_validate(rig.layout.model_dump() | {"unit": "inch"})
    assert "Correct unit and mark.size" in _refused(rig.calibrate(layout=inches))
    light = Layout.model_validate(
        rig.layout.model_dump() | {"mark": rig.layout.mark.model_dump() | {"polarity": "light"}}
    )
    assert "Correct mark.polarity" in _refused(rig.calibrate(layout=light))


def test_missing_nominal_views_and_frames_are_refused(rig: Any) -> None:
    from vaoi_station.calibration import calibrate

    heads = [h.model_copy(update={"nominal_center_mm": None}) for h in rig.heads]
    with pytest.raises(InputError, match=r"cameras\.0\.nominal_center_mm is missing"):
        calibrate(heads, lambda i: rig.frames[i], rig.layout)
    with pytest.raises(InputError, match=r"camera 1: its frame .* is listed as missing"):
        calibrate(rig.heads, lambda i: None if i else rig.frames[i], rig.layout)


def test_foreign_marks_have_no_effect(rig: Any) -> None:
    def add(camera: int, frame: Any) -> Any:
        g, free = np.random.default_rng(camera), [rig.seen_at(camera, k) for k in rig.in_view(camera)]
        for _ in range(40):
            p = g.uniform(30, (450, 330))
            if min(np.hypot(*(np.array(free) - p).T)) > 34:
                free.append(p)
                x, y = p.astype(int)
                frame[y - 3 : y + 3, x - 12 : x + 12] = 25
                frame[y - 12 : y + 12, x - 3 : x + 3] = 25
                around = np.s_[y - 15 : y + 15, x - 15 : x + 15]
                frame[around] = cv2.GaussianBlur(frame[around], (0, 0), 0.6)
        return frame

    outcome = rig.calibrate(change=add)
    assert any(len(c.detected.px) > c.used for c in outcome.cameras)
    assert max(rig.errors_px(outcome.calibration())) < 0.02


def test_a_symmetric_layout_gives_a_warning(film: Any) -> None:
    """No frame can show the orientation of such a layout, so it is accepted."""
    places = [(x, y) for x in (-7.0, 0.0, 7.0) for y in (-5.0, 5.0)]

    def laid(*more: tuple[float, float]) -> Layout:
        marks = [{"x": x, "y": y} for x, y in (*places, *more)]
        return Layout.model_validate({"mark": {"size": 1.6, "width": 0.4}, "marks": marks})

    notes = film(layout=laid(), cameras=1, distortion_px=0.0).calibrate().notes
    assert any("mirrored in x or mirrored in y or turned by 180° is the same layout" in note for note in notes)
    corrected = film(layout=laid((3.1, 1.2)), cameras=1, distortion_px=0.0).calibrate().notes
    assert not any("is the same layout" in note for note in corrected)
