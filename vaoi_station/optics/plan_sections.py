"""The sections of a plan: array, lens, motion and data, each computed from the requirements."""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.optics import array_equations, data_rates, lens_equations, motion_equations, pulse_timing
from vaoi_station.optics.quantity_checks import ceil_to_whole
from vaoi_station.optics.requirements import Requirements


@dataclass(frozen=True)
class ArrayPlan:
    """The figures of the camera array."""

    cameras_needed: float
    """Required number of cameras w·r·m_h / p_h, not rounded."""
    cameras: int
    """Number of cameras n: the chosen one, or `cameras_needed` rounded up."""
    multiplicity_h: float
    """Horizontal multiplicity m_h that n cameras achieve."""
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
    """Focal length of the chosen lens, or `focal_length_mm` if none is chosen."""
    working_distance_mm: float
    """Distance d at which `lens_mm` gives the resolution r. Equations (2) and (3) use this distance."""
    f_number: float | None
    """f-number N: the chosen value, or that of equation (3)."""
    depth_of_field_mm: float | None
    """Depth of field d_f of equation (2) at this f-number."""
    airy_disc_px: float | None
    """Diameter of the Airy disc (blur by diffraction) at this f-number."""


@dataclass(frozen=True)
class MotionPlan:
    """The figures of exposure and trigger pulses."""

    longest_exposure_us: float
    """Longest exposure time that the accepted motion blur allows; equation (5)."""
    exposure_us: float
    """Exposure time s: the chosen value, or the longest one."""
    motion_blur_px: float
    """Motion blur v·r·s at this exposure time; equation (4)."""
    lowest_frame_rate_hz: float
    """Lowest frame rate that gives the required m_v; equation (6)."""
    frame_rate_hz: float
    """Frame rate t: the chosen value, or the lowest one."""
    trigger_period_us: float
    spare_time_us: float
    """Trigger period minus exposure and readout; negative if they do not fit into it."""
    row_step_mm: float
    """Motion of the board between two rows."""
    multiplicity_v: float
    """Vertical multiplicity m_v that this frame rate achieves."""
    parallax_px_per_mm: float
    """Parallax between successive rows, in px per mm of component height."""


@dataclass(frozen=True)
class DataPlan:
    """The data rate, and the rows and memory for the longest board, which are None if its length is unknown."""

    frame_bytes: int
    data_rate_mbit_s: float
    capture_duration_s: float | None
    rows: int | None
    """Number of pulses m while the longest board is in view."""
    run_bytes: int | None
    """Memory for all frames of the longest board."""
    ring_bytes: int | None
    """Memory for the frames of all boards that the ring holds at the same time."""


def plan_lens(q: Requirements) -> LensPlan:
    """Compute lens, distance and aperture for the required resolution.

    Raises:
        InputError: if valid quantities contradict each other.
    """
    sensor = (q.sensor_px_h, q.resolution_px_per_mm, q.sensor_width_mm)
    ideal = lens_equations.focal_length_mm(q.distance_max_mm, *sensor)
    used = q.lens_mm or ideal
    distance = lens_equations.working_distance_mm(used, *sensor)
    # Equations (2) and (3) use the real distance of the chosen lens, not d_max.
    c, depth, aperture = q.circle_of_confusion_mm, None, q.f_number
    if aperture is None and c is not None and q.depth_of_field_mm is not None:
        aperture = lens_equations.f_number(q.depth_of_field_mm, distance, used, c)
    if aperture is not None and c is not None:
        depth = lens_equations.depth_of_field_mm(distance, used, aperture, c)
    airy = None
    if aperture is not None:
        airy = lens_equations.airy_disc_px(aperture, distance, used, q.sensor_px_h, q.sensor_width_mm)
    return LensPlan(ideal, used, distance, aperture, depth, airy)


def plan_motion(q: Requirements, distance_mm: float) -> MotionPlan:
    """Compute exposure and pulses, and the parallax at a working distance.

    Raises:
        InputError: if valid quantities contradict each other.
    """
    longest = motion_equations.longest_exposure_us(q.blur_px, q.speed_mm_s, q.resolution_px_per_mm)
    exposure = q.exposure_us or longest
    lowest = motion_equations.lowest_frame_rate_hz(
        q.speed_mm_s, q.resolution_px_per_mm, q.sensor_px_v, q.multiplicity_v
    )
    rate = q.frame_rate_hz or lowest
    period, step = pulse_timing.trigger_period_us(rate), q.speed_mm_s / rate
    return MotionPlan(
        longest_exposure_us=longest,
        exposure_us=exposure,
        motion_blur_px=motion_equations.motion_blur_px(q.speed_mm_s, q.resolution_px_per_mm, exposure),
        lowest_frame_rate_hz=lowest,
        frame_rate_hz=rate,
        trigger_period_us=period,
        spare_time_us=pulse_timing.spare_time_us(period, exposure, q.readout_us),
        row_step_mm=step,
        multiplicity_v=pulse_timing.achieved_multiplicity_v(rate, q.sensor_px_v, q.speed_mm_s, q.resolution_px_per_mm),
        parallax_px_per_mm=motion_equations.parallax_px_per_mm(step, distance_mm, q.resolution_px_per_mm),
    )


def plan_array(q: Requirements, distance_mm: float) -> ArrayPlan:
    """Compute the camera array, and the parallax between cameras at a working distance.

    Raises:
        InputError: if valid quantities contradict each other.
    """
    needed = array_equations.cameras_needed(q.width_mm, q.resolution_px_per_mm, q.multiplicity_h, q.sensor_px_h)
    cameras = q.cameras or ceil_to_whole(needed)
    width = array_equations.field_of_view_mm(q.sensor_px_h, q.resolution_px_per_mm)
    pitch = array_equations.camera_pitch_mm(cameras, q.width_mm, width)
    return ArrayPlan(
        cameras_needed=needed,
        cameras=cameras,
        multiplicity_h=array_equations.achieved_multiplicity_h(
            cameras, q.sensor_px_h, q.width_mm, q.resolution_px_per_mm
        ),
        field_width_mm=width,
        field_height_mm=array_equations.field_of_view_mm(q.sensor_px_v, q.resolution_px_per_mm),
        camera_pitch_mm=pitch,
        parallax_px_per_mm=motion_equations.parallax_px_per_mm(pitch, distance_mm, q.resolution_px_per_mm),
    )


def plan_data(q: Requirements, cameras: ArrayPlan, pulses: MotionPlan) -> DataPlan:
    """Compute the data rate of these cameras and pulses, and the memory for their frames.

    Raises:
        InputError: if valid quantities contradict each other.
    """
    size = data_rates.frame_bytes(q.sensor_px_h, q.sensor_px_v, q.bits_per_pixel)
    rate = data_rates.data_rate_mbit_s(
        cameras.cameras, q.sensor_px_h, q.sensor_px_v, q.bits_per_pixel, pulses.frame_rate_hz
    )
    if q.longest_board_mm is None:
        return DataPlan(size, rate, None, None, None, None)
    duration = pulse_timing.capture_duration_s(q.longest_board_mm, cameras.field_height_mm, q.speed_mm_s)
    rows = pulse_timing.rows_per_board(duration, pulses.frame_rate_hz)
    run = data_rates.buffer_bytes(cameras.cameras, rows, size)
    return DataPlan(
        size, rate, duration, rows, run, data_rates.buffer_bytes(cameras.cameras, rows, size, q.runs_in_memory)
    )
