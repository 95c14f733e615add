"""The requirements of a line and its boards: the input of a plan."""

from __future__ import annotations

from dataclasses import dataclass, fields

from vaoi_station.optics.quantity_checks import is_number, require, require_non_negative, require_positive

_WHERE = "requirements"
_WHOLE = frozenset({"sensor_px_h", "sensor_px_v", "cameras", "bits_per_pixel", "runs_in_memory"})


@dataclass(frozen=True)
class Requirements:
    """Hardware and application parameters (sections 2.2, 2.3), and quantities that are already chosen.

    Optional quantities are None if they are unknown or not chosen. The plan then chooses them, or lists a constraint
    as not checked.

    Raises:
        InputError: if a quantity is invalid; the error names field, value and limit.
    """

    width_mm: float
    """Width of the widest board, across the motion: w."""
    resolution_px_per_mm: float
    """Required resolution on the board: r."""
    speed_mm_s: float
    """Conveyor speed: v."""
    sensor_px_h: int
    """Pixels of a frame across the motion: p_h."""
    sensor_px_v: int
    """Pixels of a frame along the motion: p_v."""
    sensor_width_mm: float
    """Width of the sensor, along p_h: w_s."""
    distance_max_mm: float
    """Largest possible distance of the cameras from the board: d_max."""
    distance_min_mm: float | None = None
    """Smallest possible distance of the cameras from the board: d_min."""
    multiplicity_h: float = 1.05
    """Required number of cameras that see each point: m_h."""
    multiplicity_v: float = 2.1
    """Required number of frames of one camera that show each point: m_v."""
    depth_of_field_mm: float | None = None
    """Height of the highest component that must be sharp: d_f."""
    circle_of_confusion_mm: float | None = None
    """Largest acceptable blur spot on the sensor: c. Without it the f-number is not determined."""
    blur_px: float = 1.0
    """Largest acceptable motion during an exposure: τ."""
    lens_mm: float | None = None
    """Focal length of the chosen lens. If None, the plan uses the focal length that fits d_max."""
    f_number: float | None = None
    """Chosen f-number N. If None, the plan uses the one that gives the depth of field."""
    cameras: int | None = None
    """Chosen number of cameras n. If None, the plan uses the smallest sufficient number."""
    frame_rate_hz: float | None = None
    """Chosen frame rate t. If None, the plan uses the lowest sufficient rate."""
    exposure_us: float | None = None
    """Chosen exposure time s. If None, the plan uses the longest that the accepted motion blur allows."""
    readout_us: float = 0.0
    """Time between the end of an exposure and the earliest start of the next."""
    bits_per_pixel: int = 8
    longest_board_mm: float | None = None
    """Length of the longest board, along the motion. If None, rows and memory are not computed."""
    runs_in_memory: int = 3
    """Number of boards that the ring holds at the same time."""
    link_mbit_s: float | None = None
    """Total capacity of the links of all cameras."""

    def __post_init__(self) -> None:
        self._check_numbers()
        self._check_together()

    def _check_numbers(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            # 0 is valid for the readout alone, which is checked below; None is valid only where it is the default.
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
            require(value >= 1, name, value, "1 or above: with less, parts of the board are not filmed", _WHERE)

    def _check_together(self) -> None:
        # Limits that depend on a second quantity are checked last, when both quantities are known to be numbers.
        low, high = self.distance_min_mm, self.distance_max_mm
        if low is not None:
            require(low <= high, "distance_min_mm", low, f"at most distance_max_mm, {high} mm", _WHERE)
        if self.depth_of_field_mm is not None:
            limit = f"below distance_max_mm, {high} mm"
            require(self.depth_of_field_mm < high, "depth_of_field_mm", self.depth_of_field_mm, limit, _WHERE)
        if self.circle_of_confusion_mm is not None:
            c, limit = self.circle_of_confusion_mm, f"below sensor_width_mm, {self.sensor_width_mm} mm"
            require(c < self.sensor_width_mm, "circle_of_confusion_mm", c, limit, _WHERE)
