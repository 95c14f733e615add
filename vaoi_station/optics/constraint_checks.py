"""Checks of all constraints of section 2 of the paper for a plan."""

from __future__ import annotations

from vaoi_station.optics.constraint import Constraint, at_least, at_most, not_checked
from vaoi_station.optics.plan_sections import ArrayPlan, DataPlan, LensPlan, MotionPlan
from vaoi_station.optics.quantity_checks import ceil_to_whole
from vaoi_station.optics.requirements import Requirements


def check_constraints(
    q: Requirements, array: ArrayPlan, lens: LensPlan, motion: MotionPlan, data: DataPlan
) -> tuple[Constraint, ...]:
    """Check all constraints, in the order of section 2.4. Those with missing quantities are marked as not checked."""
    return (
        _cameras(q, array),
        _highest(q, lens),
        _lowest(q, lens),
        _depth(q, lens),
        _diffraction(q, lens),
        _blur(q, motion),
        _exposure(motion),
        _frame_rate(motion),
        _period(q, motion),
        _links(q, data),
    )


def _cameras(q: Requirements, array: ArrayPlan) -> Constraint:
    # Both sides are in pixels across the board, so the margin is the spare (or missing) width of all sensors.
    asked = q.width_mm * q.resolution_px_per_mm * q.multiplicity_h
    n = array.cameras
    reached = f"{n} camera{'s' if n > 1 else ''} reach{'es' if n == 1 else ''} m_h = {array.multiplicity_h:.3f}"
    note = f"{array.cameras_needed:.2f} needed, {ceil_to_whole(array.cameras_needed)} whole ones; {reached}"
    return at_least("cameras", "w·r·m_h ≤ n·p_h", float(n * q.sensor_px_h), asked, unit="px", note=note)


def _highest(q: Requirements, lens: LensPlan) -> Constraint:
    note = f"equation (1) at d_max: f = {lens.focal_length_mm:.1f} mm; used: {lens.lens_mm:.1f} mm"
    return at_most("highest place", "d ≤ d_max, (1)", lens.working_distance_mm, q.distance_max_mm, unit="mm", note=note)


def _lowest(q: Requirements, lens: LensPlan) -> Constraint:
    name, equation, d = "lowest place", "d ≥ d_min, (1)", lens.working_distance_mm
    if q.distance_min_mm is None:
        return not_checked(name, equation, "≥", unit="mm", note="no d_min given", missing=("distance_min_mm",), value=d)
    return at_least(name, equation, d, q.distance_min_mm, unit="mm")


def _depth(q: Requirements, lens: LensPlan) -> Constraint:
    name, equation = "depth of field", "d_f of (2), N of (3)"
    missing = tuple(key for key in ("circle_of_confusion_mm", "depth_of_field_mm") if getattr(q, key) is None)
    if q.circle_of_confusion_mm is None:
        note = "no circle of confusion given: the f-number stays open"
        return not_checked(name, equation, "≥", unit="mm", note=note, missing=missing)
    if lens.f_number is None or lens.depth_of_field_mm is None:
        note = "neither a depth of field nor an f-number given"
        return not_checked(name, equation, "≥", unit="mm", note=note, missing=missing)
    if q.depth_of_field_mm is None:
        note = f"at f/{lens.f_number:.1f}; no depth of field asked for"
        return not_checked(name, equation, "≥", unit="mm", note=note, missing=missing, value=lens.depth_of_field_mm)
    note = f"at f/{lens.f_number:.1f}" + (" of equation (3)" if q.f_number is None else "")
    return at_least(name, equation, lens.depth_of_field_mm, q.depth_of_field_mm, unit="mm", note=note)


def _diffraction(q: Requirements, lens: LensPlan) -> Constraint:
    name, equation = "diffraction", "Airy disc ≤ c"
    if lens.airy_disc_px is None or q.circle_of_confusion_mm is None:
        absent = q.circle_of_confusion_mm is None
        note = f"no {'circle of confusion' if absent else 'f-number'} to compare with"
        missing = ("circle_of_confusion_mm",) * absent + ("f_number",) * (lens.f_number is None)
        return not_checked(name, equation, "≤", unit="px", note=note, missing=missing, value=lens.airy_disc_px)
    # The circle of confusion is a length on the sensor; pixels make it comparable with the Airy disc.
    acceptable_px = q.circle_of_confusion_mm * q.sensor_px_h / q.sensor_width_mm
    note = f"at f/{lens.f_number:.1f}; not in the paper"
    return at_most(name, equation, lens.airy_disc_px, acceptable_px, unit="px", note=note)


def _blur(q: Requirements, motion: MotionPlan) -> Constraint:
    return at_most("motion blur", "v·r·s ≤ τ, (4)", motion.motion_blur_px, q.blur_px, unit="px")


def _exposure(motion: MotionPlan) -> Constraint:
    return at_most("exposure", "s ≤ τ/(v·r), (5)", motion.exposure_us, motion.longest_exposure_us, unit="µs")


def _frame_rate(motion: MotionPlan) -> Constraint:
    lowest, rate = motion.lowest_frame_rate_hz, motion.frame_rate_hz
    note = f"{lowest:.2f} frames/s needed; {rate:.2f} reach m_v = {motion.multiplicity_v:.3f}"
    return at_least("frame rate", "t ≥ v·r·m_v/p_v, (6)", rate, lowest, unit="1/s", note=note)


def _period(q: Requirements, motion: MotionPlan) -> Constraint:
    # The paper omits the readout. A sensor that cannot expose during its readout needs both times within one period.
    busy = motion.exposure_us + q.readout_us
    note = f"exposure {motion.exposure_us:.0f} µs, readout {q.readout_us:.0f} µs"
    return at_most("pulse period", "s + readout ≤ 1/t", busy, motion.trigger_period_us, unit="µs", note=note)


def _links(q: Requirements, data: DataPlan) -> Constraint:
    name, equation = "links", "n·p_h·p_v·bits·t"
    if q.link_mbit_s is None:
        note = "no capacity of the links given"
        return not_checked(
            name, equation, "≤", unit="Mbit/s", note=note, missing=("link_mbit_s",), value=data.data_rate_mbit_s
        )
    return at_most(name, equation, data.data_rate_mbit_s, q.link_mbit_s, unit="Mbit/s")
