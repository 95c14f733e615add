"""The optics plan: all figures of section 2.4 for given requirements, and all constraints with their margins."""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.optics.constraint import Constraint
from vaoi_station.optics.constraint_checks import check_constraints
from vaoi_station.optics.plan_sections import (
    ArrayPlan,
    DataPlan,
    LensPlan,
    MotionPlan,
    plan_array,
    plan_data,
    plan_lens,
    plan_motion,
)
from vaoi_station.optics.requirements import Requirements


@dataclass(frozen=True)
class Plan:
    """The optics plan of a station: requirements, computed figures by section, and checked constraints."""

    requirements: Requirements
    array: ArrayPlan
    lens: LensPlan
    motion: MotionPlan
    data: DataPlan
    constraints: tuple[Constraint, ...]

    @property
    def ok(self) -> bool:
        """Whether no constraint is violated. Constraints that could not be checked are ignored."""
        return all(c.ok is not False for c in self.constraints)


def make_plan(requirements: Requirements) -> Plan:
    """Plan the optics of a station for given requirements: compute all figures, and check all constraints.

    Raises:
        InputError: if valid quantities contradict each other.
    """
    # The lens comes first: both kinds of parallax depend on its working distance.
    lens_plan = plan_lens(requirements)
    motion_plan = plan_motion(requirements, lens_plan.working_distance_mm)
    array_plan = plan_array(requirements, lens_plan.working_distance_mm)
    data_plan = plan_data(requirements, array_plan, motion_plan)
    constraints = check_constraints(requirements, array_plan, lens_plan, motion_plan, data_plan)
    return Plan(requirements, array_plan, lens_plan, motion_plan, data_plan, constraints)
