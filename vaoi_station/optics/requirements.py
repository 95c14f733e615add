"""What a line and its boards ask of the station: the input of a plan."""

from __future__ import annotations

from dataclasses import dataclass, fields

from vaoi_station.optics.quantity_checks import is_number, require, require_non_negative, require_positive

_WHERE = "requirements"
_WHOLE = frozenset({"sensor_px_h", "sensor_px_v", "cameras", "bits_per_pixel", "runs_in_memory"})


@dataclass(frozen=True)
class Requirements:
    """Hardware and application parameters (sections 2.2, 2.3), and what has been chosen already.

    Optional quantities are None where nothing is known or chosen; the plan then chooses, or says that a
    constraint cannot be judged.

    Raises:
        InputError: naming field, value and limit of the first quantity that makes no sense.
    """

    width_mm: float
    """Widest board, across the motion: w."""
    resolution_px_per_mm: float
    """r."""
    speed_mm_s: float
    """Conveyor speed v."""
    sensor_px_h: int
    """Pixels of a frame across the motion: p_h."""
    sensor_px_v: int
    """Pixels of a frame along the motion: p_v."""
    sensor_width_mm: float
    """Width of the sensor, along p_h: w_s."""
    distance_max_mm: float
    """Highest place of the cameras above the board: d_max."""
    distance_min_mm: float | None = None
    """Lowest place of the cameras above the board: d_min."""
    multiplicity_h: float = 1.05
    """In how many cameras' frames a point is to be seen: m_h."""
    multiplicity_v: float = 2.1
    """In how many frames of one camera a point is to be seen: m_v."""
    depth_of_field_mm: float | None = None
    """Height of the highest part to be seen sharply: d_f."""
    circle_of_confusion_mm: float | None = None
    """Largest acceptable blur spot on the sensor: c. Without it the aperture stays open."""
    blur_px: float = 1.0
    """Largest acceptable motion during an exposure: τ."""
    lens_mm: float | None = None
    """Focal length of the lens in stock; None: the one that fits d_max."""
    f_number: float | None = None
    """Aperture in use; None: the one that gives the depth of field."""
    cameras: int | None = None
    """Number of cameras chosen, n; None: as many as needed."""
    frame_rate_hz: float | None = None
    """Frame rate chosen, t; None: the lowest that suffices."""
    exposure_us: float | None = None
    """Exposure time chosen, s; None: the longest that blur allows."""
    readout_us: float = 0.0
    """Time a sensor needs after an exposure before the next may begin."""
    bits_per_pixel: int = 8
    longest_board_mm: float | None = None
    """Longest board, along the motion; without it rows and memory stay open."""
    runs_in_memory: int = 3
    """Boards the ring holds at once."""
    link_mbit_s: float | None = None
    """What the links of all cameras carry together."""

    def __post_init__(self) -> None:
        self._check_numbers()
        self._check_together()

    def _check_numbers(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "readout_us" or (value is None and field.default is None):
                continue
            if field.name in _WHOLE:
                ok = is_number(value) and value == int(value) and value >= 1
                require(ok, field.name, value, "a whole number, 1 or above", _WHERE)
            else:
                require_positive(_WHERE, **{field.name: value})
        require_non_negative(_WHERE, readout_us=self.readout_us)
        require(self.bits_per_pixel <= 64, "bits_per_pixel", self.bits_per_pixel, "at most 64", _WHERE)
        for name in ("multiplicity_h", "multiplicity_v"):
            value = getattr(self, name)
            require(value >= 1, name, value, "1 or above: below, parts of the board are never filmed", _WHERE)

    def _check_together(self) -> None:
        low, high = self.distance_min_mm, self.distance_max_mm
        if low is not None:
            require(low <= high, "distance_min_mm", low, f"at most distance_max_mm, {high} mm", _WHERE)
        if self.depth_of_field_mm is not None:
            limit = f"below distance_max_mm, {high} mm"
            require(self.depth_of_field_mm < high, "depth_of_field_mm", self.depth_of_field_mm, limit, _WHERE)
        if self.circle_of_confusion_mm is not None:
            c, limit = self.circle_of_confusion_mm, f"below sensor_width_mm, {self.sensor_width_mm} mm"
            require(c < self.sensor_width_mm, "circle_of_confusion_mm", c, limit, _WHERE)
