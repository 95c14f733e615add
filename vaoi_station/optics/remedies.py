"""What would mend a violated constraint of a plan: one requirement changed just so far that the constraint holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from vaoi_station.errors import InputError
from vaoi_station.optics.plan import Constraint, Plan, make_plan

_UP, _DOWN = 1, -1
_FIELDS: dict[str, tuple[tuple[str, int], ...]] = {
    "cameras": (("cameras", _UP), ("resolution_px_per_mm", _DOWN), ("width_mm", _DOWN)),
    "highest place": (("lens_mm", _DOWN), ("distance_max_mm", _UP)),
    "lowest place": (("lens_mm", _UP), ("distance_min_mm", _DOWN)),
    "depth of field": (("f_number", _UP), ("depth_of_field_mm", _DOWN)),
    "diffraction": (("f_number", _DOWN), ("circle_of_confusion_mm", _UP)),
    "motion blur": (("exposure_us", _DOWN), ("speed_mm_s", _DOWN), ("blur_px", _UP)),
    "exposure": (("exposure_us", _DOWN), ("speed_mm_s", _DOWN), ("blur_px", _UP)),
    "frame rate": (("frame_rate_hz", _UP), ("speed_mm_s", _DOWN), ("multiplicity_v", _DOWN)),
    "pulse period": (("exposure_us", _DOWN), ("frame_rate_hz", _DOWN), ("readout_us", _DOWN)),
    "links": (("link_mbit_s", _UP), ("camera_link_mbit_s", _UP), ("frame_rate_hz", _DOWN), ("speed_mm_s", _DOWN)),
}
"""For each constraint, the requirements that can mend it, the most usual first, and the direction of the change."""
_FACTORS, _HALVINGS, _DIGITS = (1000.0, 10.0, 3.0, 1.5, 1.1), 40, 4


@dataclass(frozen=True)
class Remedy:
    """One change that would mend one constraint."""

    constraint: str
    requirement: str
    value: float
    """The nearest value of the requirement with which the constraint holds, rounded away from the present one."""
    violates: tuple[str, ...]
    """Names of constraints that hold now and would be violated with this value."""


def find_remedies(plan: Plan) -> tuple[Remedy, ...]:
    """Return the remedies of all violated constraints, in their order. A change beyond a factor of 1000 is none."""
    return tuple(
        remedy
        for constraint in plan.constraints
        if constraint.ok is False
        for requirement, direction in _FIELDS[constraint.name]
        if (remedy := _remedy(plan, constraint, requirement, direction)) is not None
    )


def _remedy(plan: Plan, constraint: Constraint, requirement: str, direction: int) -> Remedy | None:
    computed = {
        "cameras": plan.array.cameras,
        "lens_mm": plan.lens.lens_mm,
        "f_number": plan.lens.f_number,
        "exposure_us": plan.motion.exposure_us,
        "frame_rate_hz": plan.motion.frame_rate_hz,
    }
    given: float | None = getattr(plan.requirements, requirement)
    present = computed.get(requirement) if given is None else given
    if not present:
        return None

    def changed(factor: float) -> Plan | None:
        value: Any = _rounded(present * factor**direction, direction, whole=requirement == "cameras")
        try:
            return make_plan(replace(plan.requirements, **{requirement: value}))
        except InputError:  # the value contradicts another requirement
            return None

    def mends(factor: float) -> bool:
        found = changed(factor)
        return found is not None and next(c.ok for c in found.constraints if c.name == constraint.name) is True

    # A large change may contradict other requirements although a smaller one mends.
    high = next((factor for factor in _FACTORS if mends(factor)), None)
    if high is None:
        return None
    low = 1.0
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if mends(middle) else (middle, high)
    best = changed(high)
    assert best is not None
    held = {c.name for c in plan.constraints if c.ok is not False}
    violates = tuple(c.name for c in best.constraints if c.ok is False and c.name in held)
    return Remedy(constraint.name, requirement, float(getattr(best.requirements, requirement)), violates)


def _rounded(value: float, direction: int, *, whole: bool) -> float | int:
    """Round to four digits, away from the present value, so that what is rounded mends as well."""
    unit = 1.0 if whole else 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    steps = math.ceil(value / unit - 1e-9) if direction > 0 else math.floor(value / unit + 1e-9)
    return steps if whole else float(f"{steps * unit:.12g}")
