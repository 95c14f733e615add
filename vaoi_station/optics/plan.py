"""The optics plan: all figures of section 2.4 for given requirements, and all constraints with their margins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from vaoi_station.optics import equations as eq
from vaoi_station.optics.links import Link, Sender, slowest_row
from vaoi_station.optics.requirements import Requirements

_ROUNDING = 1e-9
"""Largest relative difference between value and limit that counts as equality: a plan may choose the limit itself."""


@dataclass(frozen=True)
class Constraint:
    """The inequality `value relation limit`. Its margin is negative if it is violated. All three are in `unit`."""

    name: str
    equation: str
    """The inequality as the paper writes it, with its equation number if it has one."""
    value: float | None
    relation: Literal["≤", "≥"]
    limit: float | None
    margin: float | None
    unit: str
    ok: bool | None
    """Whether the constraint is satisfied; None if a missing quantity, which `note` names, prevents the check."""
    note: str = ""
    missing: tuple[str, ...] = ()
    """Requirements that are not given and would make the check possible; empty if it was made."""


@dataclass(frozen=True)
class ArrayPlan:
    """The figures of the camera array."""

    cameras_needed: float
    """Required number of cameras, not rounded."""
    cameras: int
    multiplicity_h: float
    field_width_mm: float
    field_height_mm: float
    camera_pitch_mm: float
    parallax_px_per_mm: float
    """Parallax between neighbouring cameras, in px per mm of component height."""


@dataclass(frozen=True)
class LensPlan:
    """The figures of lens, distance and aperture. Figures that the requirements do not determine are None."""

    focal_length_mm: float
    """Focal length f of equation (1) at the distance d_max."""
    lens_mm: float
    """Focal length of the chosen lens, else `focal_length_mm`."""
    working_distance_mm: float
    """Distance d at which `lens_mm` gives the resolution r. Equations (2) and (3) use this distance, not d_max."""
    f_number: float | None
    depth_of_field_mm: float | None
    airy_disc_px: float | None


@dataclass(frozen=True)
class MotionPlan:
    """The figures of exposure and trigger pulses."""

    longest_exposure_us: float
    exposure_us: float
    motion_blur_px: float
    lowest_frame_rate_hz: float
    frame_rate_hz: float
    trigger_period_us: float
    spare_time_us: float
    """Trigger period minus exposure and readout; negative if they do not fit into it."""
    row_step_mm: float
    """Motion of the board between two rows."""
    multiplicity_v: float
    parallax_px_per_mm: float
    """Parallax between successive rows, in px per mm of component height."""


@dataclass(frozen=True)
class DataPlan:
    """The data rate, and the rows and memory for the longest board, which are None if its length is unknown."""

    frame_bytes: int
    data_rate_mbit_s: float
    row_transfer_s: float | None
    """Time in which the links carry the frames of one row; None if their speed is unknown."""
    capture_duration_s: float | None
    rows: int | None
    """Number of pulses m while the longest board is in view."""
    run_bytes: int | None
    """Memory for all frames of the longest board."""
    ring_bytes: int | None
    """Memory for the frames of all boards that the ring holds at the same time."""


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
    """Plan the optics of a station; raise InputError if valid quantities contradict each other."""
    lens = _plan_lens(requirements)
    motion = _plan_motion(requirements, lens.working_distance_mm)
    array = _plan_array(requirements, lens.working_distance_mm)
    data = _plan_data(requirements, array, motion)
    return Plan(requirements, array, lens, motion, data, tuple(_constraints(requirements, array, lens, motion, data)))


def _plan_lens(q: Requirements) -> LensPlan:
    sensor = (q.sensor_px_h, q.resolution_px_per_mm, q.sensor_width_mm)
    ideal = eq.focal_length_mm(q.distance_max_mm, *sensor)
    used = q.lens_mm or ideal
    distance = eq.working_distance_mm(used, *sensor)
    c, depth, airy, aperture = q.circle_of_confusion_mm, None, None, q.f_number
    if aperture is None and c is not None and q.depth_of_field_mm is not None:
        aperture = eq.f_number(q.depth_of_field_mm, distance, used, c)
    if aperture is not None:
        depth = None if c is None else eq.depth_of_field_mm(distance, used, aperture, c)
        airy = eq.airy_disc_px(aperture, distance, used, q.sensor_px_h, q.sensor_width_mm)
    return LensPlan(ideal, used, distance, aperture, depth, airy)


def _plan_motion(q: Requirements, distance_mm: float) -> MotionPlan:
    v, r = q.speed_mm_s, q.resolution_px_per_mm
    longest = eq.longest_exposure_us(q.blur_px, v, r)
    exposure = q.exposure_us or longest
    lowest = eq.lowest_frame_rate_hz(v, r, q.sensor_px_v, q.multiplicity_v)
    rate = q.frame_rate_hz or lowest
    period, step = 1e6 / rate, v / rate
    return MotionPlan(
        longest_exposure_us=longest,
        exposure_us=exposure,
        motion_blur_px=eq.motion_blur_px(v, r, exposure),
        lowest_frame_rate_hz=lowest,
        frame_rate_hz=rate,
        trigger_period_us=period,
        spare_time_us=eq.spare_time_us(period, exposure, q.readout_us),
        row_step_mm=step,
        multiplicity_v=eq.achieved_multiplicity_v(rate, q.sensor_px_v, v, r),
        parallax_px_per_mm=eq.parallax_px_per_mm(step, distance_mm, r),
    )


def _plan_array(q: Requirements, distance_mm: float) -> ArrayPlan:
    r = q.resolution_px_per_mm
    needed = eq.cameras_needed(q.width_mm, r, q.multiplicity_h, q.sensor_px_h)
    cameras = q.cameras or eq.ceil_to_whole(needed)
    width = eq.field_of_view_mm(q.sensor_px_h, r)
    pitch = eq.camera_pitch_mm(cameras, q.width_mm, width)
    return ArrayPlan(
        cameras_needed=needed,
        cameras=cameras,
        multiplicity_h=eq.achieved_multiplicity_h(cameras, q.sensor_px_h, q.width_mm, r),
        field_width_mm=width,
        field_height_mm=eq.field_of_view_mm(q.sensor_px_v, r),
        camera_pitch_mm=pitch,
        parallax_px_per_mm=eq.parallax_px_per_mm(pitch, distance_mm, r),
    )


def _plan_data(q: Requirements, array: ArrayPlan, motion: MotionPlan) -> DataPlan:
    n, sensor = array.cameras, (q.sensor_px_h, q.sensor_px_v, q.bits_per_pixel)
    size, rate = eq.frame_bytes(*sensor), eq.data_rate_mbit_s(n, *sensor, motion.frame_rate_hz)
    row_s = slowest_row([_sender(q, size)] * n).row_s or None
    if q.longest_board_mm is None:
        return DataPlan(size, rate, row_s, None, None, None, None)
    duration = eq.capture_duration_s(q.longest_board_mm, array.field_height_mm, q.speed_mm_s)
    rows = eq.rows_per_board(duration, motion.frame_rate_hz)
    ring = eq.buffer_bytes(n, rows, size, q.runs_in_memory)
    return DataPlan(size, rate, row_s, duration, rows, eq.buffer_bytes(n, rows, size), ring)


def _sender(q: Requirements, frame_bytes: int) -> Sender:
    return Sender(frame_bytes, (Link("the shared link", q.link_mbit_s),), q.camera_link_mbit_s, q.packet_bytes)


def _constraint(
    name: str,
    equation: str,
    value: float | None,
    relation: Literal["≤", "≥"],
    limit: float | None,
    unit: str,
    note: str = "",
    missing: tuple[str, ...] = (),
) -> Constraint:
    """Check `value relation limit`; without one of both it is not checked, because the requirements `missing` are."""
    if value is None or limit is None:
        return Constraint(name, equation, value, relation, None, None, unit, None, note, missing)
    margin = limit - value if relation == "≤" else value - limit
    margin = 0.0 if abs(margin) <= _ROUNDING * abs(limit) else margin
    return Constraint(name, equation, value, relation, limit, margin, unit, margin >= 0, note)


def _constraints(
    q: Requirements, array: ArrayPlan, lens: LensPlan, motion: MotionPlan, data: DataPlan
) -> Iterator[Constraint]:
    """Yield all constraints, in the order of section 2.4."""
    n, needed = array.cameras, array.cameras_needed
    reached = f"{n} camera{'s' if n > 1 else ''} reach{'es' if n == 1 else ''} m_h = {array.multiplicity_h:.3f}"
    note = f"{needed:.2f} needed, {eq.ceil_to_whole(needed)} whole ones; {reached}"
    # In pixels across the board, so the margin is the spare (or missing) width of all sensors.
    asked = q.width_mm * q.resolution_px_per_mm * q.multiplicity_h
    yield _constraint("cameras", "w·r·m_h ≤ n·p_h", float(n * q.sensor_px_h), "≥", asked, "px", note)
    note = f"equation (1) at d_max: f = {lens.focal_length_mm:.1f} mm; used: {lens.lens_mm:.1f} mm"
    distance, lowest_mm = lens.working_distance_mm, q.distance_min_mm
    yield _constraint("highest place", "d ≤ d_max, (1)", distance, "≤", q.distance_max_mm, "mm", note)
    open_ = ("no d_min given", ("distance_min_mm",)) if lowest_mm is None else ("", ())
    yield _constraint("lowest place", "d ≥ d_min, (1)", distance, "≥", lowest_mm, "mm", *open_)
    yield from _about_aperture(q, lens)
    yield _constraint("motion blur", "v·r·s ≤ τ, (4)", motion.motion_blur_px, "≤", q.blur_px, "px")
    yield _constraint("exposure", "s ≤ τ/(v·r), (5)", motion.exposure_us, "≤", motion.longest_exposure_us, "µs")
    lowest, rate = motion.lowest_frame_rate_hz, motion.frame_rate_hz
    note = f"{lowest:.2f} frames/s needed; {rate:.2f} reach m_v = {motion.multiplicity_v:.3f}"
    yield _constraint("frame rate", "t ≥ v·r·m_v/p_v, (6)", rate, "≥", lowest, "1/s", note)
    # The paper omits the readout. A sensor that cannot expose during its readout needs both times within one period.
    busy, note = (
        motion.exposure_us + q.readout_us,
        f"exposure {motion.exposure_us:.0f} µs, readout {q.readout_us:.0f} µs",
    )
    yield _constraint("pulse period", "s + readout ≤ 1/t", busy, "≤", motion.trigger_period_us, "µs", note)
    row_us, open_ = None, ("no capacity of the links given", ("link_mbit_s",))
    if data.row_transfer_s is not None:
        row_us = data.row_transfer_s * 1e6
        open_ = (f"limited by {slowest_row([_sender(q, data.frame_bytes)] * n).slowest}", ())
    yield _constraint("links", "row on the links ≤ 1/t", row_us, "≤", motion.trigger_period_us, "µs", *open_)


def _about_aperture(q: Requirements, lens: LensPlan) -> Iterator[Constraint]:
    c, n = q.circle_of_confusion_mm, lens.f_number
    missing = tuple(key for key in ("circle_of_confusion_mm", "depth_of_field_mm") if getattr(q, key) is None)
    note, depth = f"at f/{n:.1f}" if n is not None else "", lens.depth_of_field_mm
    if c is None:
        depth, note = None, "no circle of confusion given: the f-number stays open"
    elif n is None:
        note = "neither a depth of field nor an f-number given"
    elif q.depth_of_field_mm is None:
        note += "; no depth of field asked for"
    elif q.f_number is None:
        note += " of equation (3)"
    asked = None if c is None else q.depth_of_field_mm
    yield _constraint("depth of field", "d_f of (2), N of (3)", depth, "≥", asked, "mm", note, missing)
    missing = ("circle_of_confusion_mm",) * (c is None) + ("f_number",) * (n is None)
    note = f"at f/{n:.1f}; not in the paper" if n is not None else ""
    if missing:
        note = f"no {'circle of confusion' if c is None else 'f-number'} to compare with"
    # The circle of confusion is a length on the sensor; pixels make it comparable with the Airy disc.
    acceptable_px = None if c is None else c * q.sensor_px_h / q.sensor_width_mm
    yield _constraint("diffraction", "Airy disc ≤ c", lens.airy_disc_px, "≤", acceptable_px, "px", note, missing)
