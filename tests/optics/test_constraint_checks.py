"""The constraints that a plan lists; tests/optics/test_optics_plan.py tests each of them violated and met."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.optics import Constraint, Requirements
from vaoi_station.optics.constraint_checks import check_constraints
from vaoi_station.optics.paper_example import PAPER
from vaoi_station.optics.plan_sections import plan_array, plan_data, plan_lens, plan_motion

NAMES = (
    "cameras",
    "highest place",
    "lowest place",
    "depth of field",
    "diffraction",
    "motion blur",
    "exposure",
    "frame rate",
    "pulse period",
    "links",
)


def check(q: Requirements) -> dict[str, Constraint]:
    lens = plan_lens(q)
    motion, array = plan_motion(q, lens.working_distance_mm), plan_array(q, lens.working_distance_mm)
    return {c.name: c for c in check_constraints(q, array, lens, motion, plan_data(q, array, motion))}


def test_all_constraints_are_listed_in_the_order_of_the_paper() -> None:
    assert tuple(check(PAPER)) == NAMES


@pytest.mark.parametrize(
    ("change", "name", "note"),
    [
        ({}, "lowest place", "no d_min given"),
        ({}, "depth of field", "no circle of confusion given: the f-number stays open"),
        (
            {"circle_of_confusion_mm": 0.01, "depth_of_field_mm": None},
            "depth of field",
            "neither a depth of field nor an f-number given",
        ),
        (
            {"circle_of_confusion_mm": 0.01, "depth_of_field_mm": None, "f_number": 8.0},
            "depth of field",
            "at f/8.0; no depth of field asked for",
        ),
        ({}, "diffraction", "no circle of confusion to compare with"),
        ({"circle_of_confusion_mm": 0.01, "depth_of_field_mm": None}, "diffraction", "no f-number to compare with"),
        ({}, "links", "no capacity of the links given"),
    ],
)
def test_a_missing_quantity_is_named(change: dict[str, Any], name: str, note: str) -> None:
    constraint = check(replace(PAPER, **change))[name]
    assert constraint.ok is None
    assert constraint.note == note
    # What is named as missing is what makes the check possible.
    values = {"distance_min_mm": 10.0, "circle_of_confusion_mm": 0.01, "depth_of_field_mm": 5.0, "link_mbit_s": 1000.0}
    values["f_number"] = 8.0
    assert constraint.missing
    given = change | {key: values[key] for key in constraint.missing}
    assert check(replace(PAPER, **given))[name].ok is not None


def test_the_note_on_cameras_is_right_for_one_camera() -> None:
    assert "1 camera reaches m_h" in check(replace(PAPER, width_mm=20.0, cameras=None))["cameras"].note
    assert "12 cameras reach m_h" in check(PAPER)["cameras"].note


def test_the_pulse_period_must_contain_exposure_and_readout() -> None:
    period = check(replace(PAPER, readout_us=100_000.0))["pulse period"]
    assert (period.value, period.limit) == (100_250.0, 125_000.0)
    assert period.note == "exposure 250 µs, readout 100000 µs"
