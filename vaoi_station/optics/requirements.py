"""The requirements of a line and its boards: the input of a plan."""

from __future__ import annotations

from dataclasses import dataclass, fields

from vaoi_station.optics.equations import is_number, require, require_positive
from vaoi_station.optics.links import GVSP_OVERHEAD, LARGEST_PACKET

_WHERE = "requirements"
_WHOLE = frozenset({"sensor_px_h", "sensor_px_v", "cameras", "bits_per_pixel", "runs_in_memory", "packet_bytes"})


@dataclass(frozen=True)
class Requirements:
    """Hardware and application parameters (sections 2.2, 2.3), and quantities that are already chosen.

    The plan chooses optional quantities that are None, or lists a constraint as not checked.

    Raises:
        InputError: a quantity is invalid; the error names field, value and limit.
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
    """Smallest such distance: d_min."""
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
    """Focal length of the chosen lens; else the one that fits d_max."""
    f_number: float | None = None
    """Chosen f-number N; else the one that gives the depth of field."""
    cameras: int | None = None
    """Chosen number of cameras n; else the smallest sufficient one."""
    frame_rate_hz: float | None = None
    """Chosen frame rate t; else the lowest sufficient one."""
    exposure_us: float | None = None
    """Chosen exposure time s; else the longest that the accepted motion blur allows."""
    readout_us: float = 0.0
    """Time between the end of an exposure and the earliest start of the next."""
    bits_per_pixel: int = 8
    longest_board_mm: float | None = None
    """Length of the longest board, along the motion; without it rows and memory are not computed."""
    runs_in_memory: int = 3
    """Number of boards that the ring holds at the same time."""
    link_mbit_s: float | None = None
    """Capacity of the link that all cameras share: port, uplink of a switch, or all their ports together."""
    camera_link_mbit_s: float | None = None
    """Speed of one camera's own link; None: not slower than the shared one."""
    packet_bytes: int = LARGEST_PACKET
    """Packet size with headers."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            if field.name in _WHOLE:
                ok = is_number(value) and value == int(value) and value >= 1
                require(ok, field.name, value, "a whole number, 1 or above", _WHERE)
            else:
                require_positive(_WHERE, field.name, value, or_zero=field.name == "readout_us")
        low_packet = GVSP_OVERHEAD + 1
        require(self.packet_bytes >= low_packet, "packet_bytes", self.packet_bytes, f"at least {low_packet}", _WHERE)
        require(self.bits_per_pixel <= 64, "bits_per_pixel", self.bits_per_pixel, "at most 64", _WHERE)
        for name in ("multiplicity_h", "multiplicity_v"):
            value = getattr(self, name)
            require(value >= 1, name, value, "1 or above: with less, parts of the board are not filmed", _WHERE)
        low, depth, c, high = (
            self.distance_min_mm, self.depth_of_field_mm, self.circle_of_confusion_mm, self.distance_max_mm,
        )  # fmt: skip
        if low is not None:
            require(low <= high, "distance_min_mm", low, f"at most distance_max_mm, {high} mm", _WHERE)
        if depth is not None:
            require(depth < high, "depth_of_field_mm", depth, f"below distance_max_mm, {high} mm", _WHERE)
        if c is not None:
            limit = f"below sensor_width_mm, {self.sensor_width_mm} mm"
            require(c < self.sensor_width_mm, "circle_of_confusion_mm", c, limit, _WHERE)
