from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.optics import Requirements, make_plan
from vaoi_station.optics.paper_example import PAPER
from vaoi_station.optics.remedies import find_remedies

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


def test_the_change_is_the_smallest_one() -> None:
    found = {(r.constraint, r.requirement): r.value for r in find_remedies(make_plan(PAPER))}
    assert found["cameras", "cameras"] == 13
    assert found["frame rate", "frame_rate_hz"] == 8.077
    assert found["frame rate", "speed_mm_s"] == 99.04


def test_a_plan_without_violations_needs_none() -> None:
    assert find_remedies(make_plan(replace(PAPER, cameras=13, frame_rate_hz=8.1))) == ()
