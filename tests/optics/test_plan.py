from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics import Constraint, Requirements, make_plan
from vaoi_station.optics.remedies import find_remedies
from vaoi_station.optics.report import PAPER, compare_with_paper, format_plan, plan_to_json

FREE = replace(PAPER, cameras=None, frame_rate_hz=None, lens_mm=None)


def constraint(name: str, base: Requirements = PAPER, **change: Any) -> Constraint:
    return next(c for c in make_plan(replace(base, **change)).constraints if c.name == name)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"width_mm": None}, "width_mm is None, but must be a finite number above 0"),
        ({"resolution_px_per_mm": float("nan")}, "resolution_px_per_mm is nan"),
        ({"sensor_px_h": 1392.5}, "sensor_px_h is 1392.5, but must be a whole number, 1 or above"),
        ({"cameras": 0}, "cameras is 0, but must be a whole number, 1 or above"),
        ({"multiplicity_h": 0.99}, "multiplicity_h is 0.99, but must be 1 or above"),
        ({"readout_us": -1}, "readout_us is -1, but must be a finite number, 0 or above"),
        ({"bits_per_pixel": 65}, "bits_per_pixel is 65, but must be at most 64"),
        ({"distance_min_mm": 501}, "distance_min_mm is 501, but must be at most distance_max_mm, 500.0 mm"),
        ({"depth_of_field_mm": 500}, "depth_of_field_mm is 500, but must be below distance_max_mm"),
        ({"circle_of_confusion_mm": 6.4}, "circle_of_confusion_mm is 6.4, but must be below sensor_width_mm, 6.4 mm"),
    ],
)
def test_invalid_requirements_are_refused_with_field_value_and_limit(change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        replace(PAPER, **change)
    assert str(refused.value).startswith(f"requirements: {complaint}")


def test_the_plan_reports_both_favourable_roundings_of_the_paper() -> None:
    plan = make_plan(PAPER)
    assert not plan.ok
    assert [c.name for c in plan.constraints if c.ok is False] == ["cameras", "frame rate"]
    cameras, rate = constraint("cameras"), constraint("frame rate")
    assert (cameras.value, cameras.limit, cameras.margin) == pytest.approx((16704, 16800, -96))
    assert cameras.note == "12.07 needed, 13 whole ones; 12 cameras reach m_h = 1.044"
    assert (rate.value, rate.limit, rate.margin) == pytest.approx((8, 8.0769, -0.0769), abs=1e-4)
    assert "1 camera reaches m_h" in constraint("cameras", width_mm=20.0, cameras=None).note


def test_the_papers_printed_figures_agree_with_the_equations_or_are_explained() -> None:
    figures = {f.name: f for f in compare_with_paper(make_plan(PAPER))}
    tolerances = {"focal length at d_max": 0.05, "distance for the 75 mm lens": 0.5, "data rate": 0.05}
    for name in (*tolerances, "longest exposure", "capture duration"):
        assert figures[name].computed == pytest.approx(figures[name].paper, abs=tolerances.get(name, 1e-9))
    for name, computed in (("cameras needed", 12.069), ("lowest frame rate", 8.0769)):
        assert figures[name].computed == pytest.approx(computed, abs=1e-3)
        assert "rounds in its own favour" in figures[name].remark
    assert (figures["f-number"].paper, figures["f-number"].computed) == (None, None)
    assert "gives none" in figures["f-number"].remark


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
def test_a_free_plan_chooses_what_just_suffices(q: Requirements) -> None:
    plan = make_plan(q)
    assert plan.ok
    array, motion = plan.array, plan.motion
    assert array.cameras - 1 < array.cameras_needed <= array.cameras + 1e-6
    assert (array.cameras - 1) * array.camera_pitch_mm + array.field_width_mm >= q.width_mm * (1 - 1e-9)
    assert (motion.motion_blur_px, motion.multiplicity_v) == pytest.approx((q.blur_px, q.multiplicity_v))
    assert motion.row_step_mm * motion.frame_rate_hz == pytest.approx(q.speed_mm_s)
    assert plan.lens.working_distance_mm == pytest.approx(q.distance_max_mm)
    assert {c.name: c.margin for c in plan.constraints if c.name in ("highest place", "exposure")} == {
        "highest place": 0,
        "exposure": 0,
    }


@pytest.mark.parametrize(
    ("name", "violating", "holding"),
    [
        ("cameras", {"cameras": 12}, {"cameras": 13}),
        ("highest place", {"lens_mm": 80.0}, {"lens_mm": 75.0}),
        ("lowest place", {"lens_mm": 50.0, "distance_min_mm": 400.0}, {"lens_mm": 75.0, "distance_min_mm": 400.0}),
        ("depth of field", {"circle_of_confusion_mm": 0.0092, "f_number": 8.0}, {"f_number": 32.0}),
        ("diffraction", {"circle_of_confusion_mm": 0.0092, "f_number": 32.0}, {"f_number": 5.6}),
        ("motion blur", {"exposure_us": 251.0}, {"exposure_us": 250.0}),
        ("exposure", {"exposure_us": 251.0}, {"exposure_us": 250.0}),
        ("frame rate", {"frame_rate_hz": 8.0}, {"frame_rate_hz": 8.1}),
        ("pulse period", {"readout_us": 130000.0}, {"readout_us": 100000.0}),
        ("links", {"link_mbit_s": 1200.0}, {"link_mbit_s": 1600.0}),
    ],
)
def test_each_constraint_can_be_violated_and_can_hold(
    name: str, violating: dict[str, Any], holding: dict[str, Any]
) -> None:
    broken, held = constraint(name, FREE, **violating), constraint(name, FREE, **violating | holding)
    assert (broken.ok, held.ok) == (False, True)
    assert broken.margin is not None
    assert held.margin is not None
    assert broken.margin < 0 <= held.margin


@pytest.mark.parametrize(
    ("name", "change", "note"),
    [
        ("lowest place", {}, "no d_min given"),
        ("depth of field", {}, "no circle of confusion given: the f-number stays open"),
        (
            "depth of field",
            {"circle_of_confusion_mm": 0.01, "depth_of_field_mm": None},
            "neither a depth of field nor an f-number given",
        ),
        (
            "depth of field",
            {"circle_of_confusion_mm": 0.01, "depth_of_field_mm": None, "f_number": 8.0},
            "at f/8.0; no depth of field asked for",
        ),
        ("diffraction", {}, "no circle of confusion to compare with"),
        ("diffraction", {"circle_of_confusion_mm": 0.01, "depth_of_field_mm": None}, "no f-number to compare with"),
        ("links", {}, "no capacity of the links given"),
    ],
)
def test_a_missing_quantity_is_named_and_makes_the_check_possible(name: str, change: dict[str, Any], note: str) -> None:
    found = constraint(name, **change)
    assert (found.ok, found.margin, found.note) == (None, None, note)
    values = {"distance_min_mm": 10.0, "circle_of_confusion_mm": 0.01, "depth_of_field_mm": 5.0, "link_mbit_s": 1000.0}
    values["f_number"] = 8.0
    assert found.missing
    assert constraint(name, **change | {key: values[key] for key in found.missing}).ok is not None


def test_depth_of_field_is_computed_at_the_working_distance() -> None:
    plan = make_plan(replace(PAPER, circle_of_confusion_mm=0.0046))
    assert plan.lens.f_number == pytest.approx(10 * 75**2 / (0.0046 * (482.8125 - 75) * (482.8125 - 10)))
    assert plan.lens.depth_of_field_mm == pytest.approx(10)
    with pytest.raises(InputError, match="depth_of_field_mm is 490"):
        make_plan(replace(PAPER, depth_of_field_mm=490.0, circle_of_confusion_mm=0.01))


def test_memory_is_rows_times_cameras_times_frames_and_stays_open_without_a_board() -> None:
    data = make_plan(replace(PAPER, bits_per_pixel=16, runs_in_memory=4)).data
    assert (data.frame_bytes, data.rows) == (2 * 1392 * 1040, 40)
    assert (data.run_bytes, data.ring_bytes) == (12 * 40 * data.frame_bytes, 4 * 12 * 40 * data.frame_bytes)
    open_ = make_plan(replace(PAPER, longest_board_mm=None))
    assert (open_.data.capture_duration_s, open_.data.rows, open_.data.ring_bytes) == (None, None, None)
    lines = [line.split() for line in format_plan(open_).splitlines()]
    assert ["rows", "of", "the", "longest", "board", "m", "open"] in lines


FAULTY = replace(PAPER, exposure_us=2000.0, link_mbit_s=10.0, lens_mm=5.0, distance_min_mm=400.0)
APERTURE = replace(PAPER, circle_of_confusion_mm=0.005, depth_of_field_mm=10.0, f_number=4.0)
BUSY = replace(PAPER, cameras=None, frame_rate_hz=None, readout_us=130_000.0)


@pytest.mark.parametrize("requirements", [PAPER, FAULTY, APERTURE, BUSY], ids=["paper", "faulty", "aperture", "busy"])
def test_every_remedy_mends_its_constraint_and_names_what_it_violates(requirements: Requirements) -> None:
    plan = make_plan(requirements)
    violated = {c.name for c in plan.constraints if c.ok is False}
    remedies = find_remedies(plan)
    assert {r.constraint for r in remedies} == violated
    for remedy in remedies:
        value: Any = int(remedy.value) if remedy.requirement == "cameras" else remedy.value
        states = {c.name: c.ok for c in make_plan(replace(requirements, **{remedy.requirement: value})).constraints}
        assert states[remedy.constraint] is True, remedy
        assert set(remedy.violates) == {name for name, ok in states.items() if ok is False} - violated


def test_a_remedy_is_the_smallest_change() -> None:
    found = {(r.constraint, r.requirement): r.value for r in find_remedies(make_plan(PAPER))}
    assert found["cameras", "cameras"] == 13
    assert found["frame rate", "frame_rate_hz"] == 8.077
    assert found["frame rate", "speed_mm_s"] == 99.04
    assert find_remedies(make_plan(replace(PAPER, cameras=13, frame_rate_hz=8.1))) == ()


def test_the_json_data_has_all_sections() -> None:
    plan = make_plan(PAPER)
    document = plan_to_json(plan)
    assert set(document) == {"requirements", "array", "lens", "motion", "data", "constraints", "ok", "remedies"}
    assert [f["name"] for f in plan_to_json(plan, compare_with_paper(plan))["paper"]][:1] == ["cameras needed"]
