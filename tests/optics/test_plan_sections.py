from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.optics.paper_example import PAPER
from vaoi_station.optics.plan_sections import plan_array, plan_data, plan_lens, plan_motion

FREE = replace(PAPER, cameras=None, frame_rate_hz=None, lens_mm=None)


def test_a_chosen_lens_sets_the_distance_and_a_free_one_stands_at_d_max() -> None:
    assert plan_lens(PAPER).working_distance_mm == pytest.approx(482.8125)
    free = plan_lens(FREE)
    assert free.lens_mm == free.focal_length_mm
    assert free.working_distance_mm == pytest.approx(PAPER.distance_max_mm)


def test_a_given_f_number_determines_the_depth_and_a_given_depth_the_f_number() -> None:
    by_depth = plan_lens(replace(PAPER, circle_of_confusion_mm=0.01))
    assert by_depth.depth_of_field_mm == pytest.approx(10)
    assert by_depth.f_number is not None
    by_number = plan_lens(replace(PAPER, circle_of_confusion_mm=0.01, f_number=by_depth.f_number))
    assert by_number.depth_of_field_mm == pytest.approx(10)
    assert by_number.airy_disc_px == pytest.approx(by_depth.airy_disc_px)


def test_an_f_number_without_circle_of_confusion_gives_diffraction_only() -> None:
    lens = plan_lens(replace(PAPER, f_number=8.0))
    assert lens.depth_of_field_mm is None
    assert lens.airy_disc_px is not None


@given(st.floats(10, 400), st.floats(5, 80))
def test_a_free_motion_just_meets_blur_and_multiplicity(speed: float, resolution: float) -> None:
    q = replace(FREE, speed_mm_s=speed, resolution_px_per_mm=resolution)
    motion = plan_motion(q, 500.0)
    assert motion.motion_blur_px == pytest.approx(q.blur_px)
    assert motion.multiplicity_v == pytest.approx(q.multiplicity_v)
    assert motion.row_step_mm * motion.frame_rate_hz == pytest.approx(speed)
    assert motion.trigger_period_us * motion.frame_rate_hz == pytest.approx(1e6)


@given(st.floats(30, 800), st.floats(5, 80))
def test_a_free_array_covers_the_board(width: float, resolution: float) -> None:
    q = replace(FREE, width_mm=width, resolution_px_per_mm=resolution)
    array = plan_array(q, 500.0)
    covered = (array.cameras - 1) * array.camera_pitch_mm + array.field_width_mm
    assert covered >= width * (1 - 1e-9)
    assert array.cameras - 1 < array.cameras_needed <= array.cameras + 1e-6
    assert array.camera_pitch_mm < array.field_width_mm


def test_memory_is_rows_times_cameras_times_frames() -> None:
    q = replace(PAPER, bits_per_pixel=16, runs_in_memory=4)
    array, motion = plan_array(q, 483.0), plan_motion(q, 483.0)
    data = plan_data(q, array, motion)
    assert data.frame_bytes == 2 * 1392 * 1040
    assert data.rows == 40
    assert data.run_bytes == 12 * 40 * data.frame_bytes
    assert data.ring_bytes == 4 * data.run_bytes
    assert data.data_rate_mbit_s == pytest.approx(2 * 1111.8182, abs=1e-3)
