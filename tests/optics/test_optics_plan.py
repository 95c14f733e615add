from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import Constraint, Plan, Requirements, make_plan
from vaoi_station.optics.paper_example import PAPER, compare_with_paper

FREE = replace(PAPER, cameras=None, frame_rate_hz=None, lens_mm=None)


def constraint(plan: Plan, name: str) -> Constraint:
    return next(c for c in plan.constraints if c.name == name)


def test_the_papers_choice_gives_the_papers_figures() -> None:
    plan = make_plan(PAPER)
    assert plan.lens.focal_length_mm == pytest.approx(77.7, abs=0.05)
    assert plan.lens.working_distance_mm == pytest.approx(483, abs=0.5)
    assert plan.motion.longest_exposure_us == pytest.approx(250)
    assert plan.data.data_rate_mbit_s == pytest.approx(1111.8, abs=0.05)
    assert plan.data.capture_duration_s == pytest.approx(5)
    assert plan.data.rows == 40


def test_the_plan_reports_both_favourable_roundings_of_the_paper() -> None:
    plan = make_plan(PAPER)
    assert not plan.ok
    assert [c.name for c in plan.constraints if c.ok is False] == ["cameras", "frame rate"]
    cameras, rate = constraint(plan, "cameras"), constraint(plan, "frame rate")
    assert (cameras.value, cameras.limit, cameras.margin) == pytest.approx((16704, 16800, -96))
    assert "12.07 needed, 13 whole ones" in cameras.note
    assert (rate.value, rate.limit, rate.margin) == pytest.approx((8, 8.0769, -0.0769), abs=1e-4)
    remarks = {f.name: f.remark for f in compare_with_paper(plan)}
    assert "own favour: 12.07" in remarks["cameras needed"]
    assert "own favour: 8.08" in remarks["lowest frame rate"]


def test_without_a_circle_of_confusion_the_aperture_stays_open() -> None:
    plan = make_plan(PAPER)
    assert (plan.lens.f_number, plan.lens.depth_of_field_mm, plan.lens.airy_disc_px) == (None, None, None)
    depth = constraint(plan, "depth of field")
    assert (depth.ok, depth.limit, depth.margin) == (None, None, None)
    assert "f-number stays open" in depth.note
    figure = next(f for f in compare_with_paper(plan) if f.name == "f-number")
    assert (figure.paper, figure.computed) == (None, None)
    assert "gives none" in figure.remark


def test_a_free_plan_chooses_what_just_suffices() -> None:
    plan = make_plan(FREE)
    assert plan.ok
    assert plan.array.cameras == 13
    assert plan.motion.frame_rate_hz == pytest.approx(8.0769, abs=1e-4)
    assert plan.motion.multiplicity_v == pytest.approx(2.1)
    assert plan.lens.lens_mm == plan.lens.focal_length_mm
    assert plan.lens.working_distance_mm == pytest.approx(500)
    assert constraint(plan, "highest place").margin == 0
    assert constraint(plan, "exposure").margin == 0


@given(
    st.builds(
        Requirements,
        width_mm=st.floats(50, 500),
        resolution_px_per_mm=st.floats(5, 80),
        speed_mm_s=st.floats(10, 400),
        sensor_px_h=st.integers(600, 5000),
        sensor_px_v=st.integers(600, 5000),
        sensor_width_mm=st.floats(3, 40),
        distance_max_mm=st.floats(200, 900),
        multiplicity_h=st.floats(1, 3),
        multiplicity_v=st.floats(1, 4),
        blur_px=st.floats(0.5, 4),
    )
)
def test_a_free_plan_violates_no_constraint(requirements: Requirements) -> None:
    plan = make_plan(requirements)
    assert plan.ok
    for c in plan.constraints:
        if c.ok is not None:
            assert c.margin is not None
            assert c.ok is (c.margin >= 0)


@pytest.mark.parametrize(
    ("change", "violated"),
    [
        ({"cameras": 12}, "cameras"),
        ({"lens_mm": 80.0}, "highest place"),
        ({"lens_mm": 50.0, "distance_min_mm": 400.0}, "lowest place"),
        ({"circle_of_confusion_mm": 0.0092, "f_number": 8.0}, "depth of field"),
        ({"circle_of_confusion_mm": 0.0092, "f_number": 32.0}, "diffraction"),
        ({"exposure_us": 251.0}, "motion blur"),
        ({"exposure_us": 251.0}, "exposure"),
        ({"frame_rate_hz": 8.0}, "frame rate"),
        ({"readout_us": 130000.0}, "pulse period"),
        ({"link_mbit_s": 1200.0}, "links"),
    ],
)
def test_each_constraint_can_be_violated_and_can_hold(change: dict[str, Any], violated: str) -> None:
    broken = constraint(make_plan(replace(FREE, **change)), violated)
    assert broken.ok is False
    assert broken.margin is not None
    assert broken.margin < 0
    relaxing: dict[str, dict[str, Any]] = {
        "cameras": {"cameras": 13},
        "highest place": {"lens_mm": 75.0},
        "lowest place": {"lens_mm": 75.0, "distance_min_mm": 400.0},
        "depth of field": {"circle_of_confusion_mm": 0.0092, "f_number": 32.0},
        "diffraction": {"circle_of_confusion_mm": 0.0092, "f_number": 5.6},
        "motion blur": {"exposure_us": 250.0},
        "exposure": {"exposure_us": 250.0},
        "frame rate": {"frame_rate_hz": 8.1},
        "pulse period": {"readout_us": 100000.0},
        "links": {"link_mbit_s": 1600.0},
    }
    held = constraint(make_plan(replace(FREE, **relaxing[violated])), violated)
    assert held.ok is True
    assert held.margin is not None
    assert held.margin >= 0


def test_depth_of_field_is_computed_at_the_working_distance() -> None:
    plan = make_plan(replace(PAPER, circle_of_confusion_mm=0.0046))
    assert plan.lens.f_number == pytest.approx(10 * 75**2 / (0.0046 * (482.8125 - 75) * (482.8125 - 10)))
    assert plan.lens.depth_of_field_mm == pytest.approx(10)
    assert constraint(plan, "depth of field").margin == 0


def test_a_depth_that_the_lens_cannot_have_is_refused() -> None:
    with pytest.raises(InputError, match="depth_of_field_mm is 490"):
        make_plan(replace(PAPER, depth_of_field_mm=490.0, circle_of_confusion_mm=0.01))


def test_without_a_board_memory_stays_open() -> None:
    data = make_plan(replace(PAPER, longest_board_mm=None)).data
    assert (data.capture_duration_s, data.rows, data.run_bytes, data.ring_bytes) == (None, None, None, None)
    assert data.frame_bytes == 1392 * 1040


def test_the_ring_holds_the_runs_that_were_asked_for() -> None:
    data = make_plan(replace(PAPER, runs_in_memory=5)).data
    assert data.run_bytes == 12 * 40 * 1392 * 1040
    assert data.ring_bytes == 5 * data.run_bytes
