"""`station.toml` → one frozen `StationConfig`; unknown keys and impossible values are refused.

Relative paths in the file are relative to the file. Lengths along the line are in tester
coordinates (mm in the conveyor's plane, axes and origin of the calibration board).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from vaoi_station.files.documents import parse, read_toml
from vaoi_station.model import CameraHead, Finite, Positive, Whole
from vaoi_station.pixel_formats import PIXEL_FORMATS, PixelFormatName

MethodName = Literal["auto", "fiducials", "features", "reference"]
"""Ways to stitch; `stitching.method` says what each looks at."""
NotNegative = Annotated[Finite, Field(ge=0)]
Pixels = Annotated[Whole, Field(ge=0)]
Word = Annotated[str, Field(min_length=1)]

CAMERAS_OF = {"simulated": "simulated", "replay": "replay", "serial": "aravis"}
"""Backend of the controller → that of its cameras: they stand for one world."""
TABLE_OF = {"simulated": "simulation", "replay": "replay"}
"""Backend of the controller → the table that describes what it stands in for."""

LONGEST_GAP_S = 2147.0
"""The protocol's 32 bits of ticks of 0.5 µs (hw/protocol.md), whole seconds of them."""


class Section(BaseModel):
    """A table of the file: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ExpectedBoard(Section):
    """Where the board lies when the first row is filmed, and how well that is known.

    The leading edge follows from barrier, delay and speed; across the line a fixed rail or the middle
    of the conveyor guides the board.
    """

    rail_mm: Finite | None = None
    """Tester coordinate, across the motion, of the board's edge at the fixed rail (its lower edge there)."""
    center_mm: Finite | None = None
    """The same for the board's middle, on lines that centre boards."""
    rotation_deg: Literal[0, 90, 180, 270] = 0
    """Quarter turns by which the board lies turned on the belt, from CAD-upright, as the camera sees it."""
    tolerance_mm: Positive = 4.0
    rotation_tolerance_deg: Annotated[Positive, Field(le=30)] = 3.0

    @model_validator(mode="after")
    def _one_guide(self) -> Self:
        if self.rail_mm is not None and self.center_mm is not None:
            raise ValueError("rail_mm and center_mm exclude each other; give the one that guides the board")
        return self


class Line(Section):
    """The mechanics of the line."""

    conveyor_mm_s: tuple[Finite, Finite]
    """Nominal velocity of the board in tester coordinates."""
    barrier_mm: Finite
    """Tester coordinate, along the motion, of the light barrier."""
    start_delay_s: NotNegative
    """From the barrier's interruption to the first pulse."""
    trigger_period_s: Positive
    tail_s: NotNegative
    """How long the pulses go on after the board has left the barrier."""
    longest_board_mm: Positive
    debounce_s: NotNegative = 0.005
    """Shorter interruptions of the barrier are bounces."""
    expected_board: ExpectedBoard = ExpectedBoard()

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.speed_mm_s == 0:
            raise ValueError("conveyor_mm_s is [0, 0]; boards would never pass")
        if self.start_delay_s > self.passing_s:
            raise ValueError(
                f"start_delay_s is {self.start_delay_s}, but the longest board has passed the barrier and "
                f"the tail is over after {self.passing_s:.3f} s"
            )
        return self

    @property
    def speed_mm_s(self) -> float:
        """The paper's v."""
        return math.hypot(*self.conveyor_mm_s)

    @property
    def passing_s(self) -> float:
        """From the barrier's interruption by the longest board to the end of its tail."""
        return self.longest_board_mm / self.speed_mm_s + self.tail_s

    @property
    def rows_of_longest_board(self) -> int:
        """Pulses of the longest passage: while it covers the barrier, and the tail. The paper's m."""
        return 1 + math.ceil((self.passing_s - self.start_delay_s) / self.trigger_period_s)


class CameraConfig(Section):
    """One camera of the array, in the order of the calibration."""

    name: str
    backend: Literal["simulated", "replay", "aravis"] = "simulated"
    width: Annotated[Whole, Field(ge=16, le=65536)]
    height: Annotated[Whole, Field(ge=16, le=65536)]
    exposure_us: Positive
    readout_us: NotNegative = 0.0
    """How long after an exposure the next one may begin; 0: it exposes while it reads out."""
    pixel_format: PixelFormatName = "Mono8"
    serial: Word | None = None
    """An Aravis camera's serial number."""
    address: Word | None = None
    """In place of it: its IP address or host name, which finds it without a search."""
    offset_px: tuple[Pixels, Pixels] = (0, 0)
    """Column and row of the sensor where the frame begins."""
    gain_db: Finite = 0.0
    trigger_line: Word | None = None
    """The camera's input the trigger is wired to; None: the one usual for its make."""
    packet_bytes: Annotated[Whole, Field(ge=576, le=65535)] | None = None
    """Largest packet; None: what the interface takes, 9000 at most."""
    link_mbit_s: Positive | None = None
    """Of the port whose cameras share one cable; None: what the interface says."""
    features: dict[str, bool | Whole | Finite | str] = {}
    """Further settings by their GenICam names, written in this order before the trigger's."""
    nominal_center_mm: tuple[Finite, Finite] | None = None
    """Where it is meant to look, by the mechanical design; calibration needs it to a few mm."""
    nominal_px_per_mm: Positive | None = None

    @property
    def label(self) -> str:
        """How sentences call it: "camera left", but "camera 0" where that is its name already."""
        return self.name if self.name.lower().startswith("camera") else f"camera {self.name}"

    @property
    def head(self) -> CameraHead:
        """What a recording says of it."""
        return CameraHead(
            width=self.width,
            height=self.height,
            exposure_us=self.exposure_us,
            nominal_center_mm=self.nominal_center_mm,
            nominal_px_per_mm=self.nominal_px_per_mm,
        )

    @property
    def frame_bytes(self) -> int:
        """Size of one frame in the ring."""
        return PIXEL_FORMATS[self.pixel_format].nbytes(self.width, self.height)

    @model_validator(mode="after")
    def _one_of_a_kind(self) -> Self:
        if self.backend == "aravis":
            if (self.serial is None) == (self.address is None):
                raise ValueError(f"camera {self.name!r} needs a serial or an address, and not both")
        elif self.serial is not None or self.address is not None:
            raise ValueError(f"camera {self.name!r} has backend {self.backend!r}, which has no serial and no address")
        elif not PIXEL_FORMATS[self.pixel_format].in_place:
            raise ValueError(f"camera {self.name!r} has backend {self.backend!r}, which sends Mono8 or Mono16 only")
        return self


class LightConfig(Section):
    """A light pattern: LED channels that are lit together, and for how long."""

    channels: Annotated[tuple[Annotated[Whole, Field(ge=0, le=7)], ...], Field(min_length=1)]
    on_us: Positive


class ControllerConfig(Section):
    """The microcontroller that fires cameras and LEDs."""

    backend: Literal["simulated", "replay", "serial"] = "simulated"
    port: Word = "/dev/vaoi-trigger"
    """Its serial port, by a name that stays: deploy/71-vaoi-controller.rules makes this one."""
    baud: Annotated[Whole, Field(ge=9600, le=2_000_000)] = 250_000
    trigger_us: Annotated[Positive, Field(ge=50, le=2000)] = 100.0
    """Width of the cameras' trigger, within the limits of hw/protocol.md."""
    min_gap_s: Annotated[NotNegative, Field(le=LONGEST_GAP_S)] = 0.0
    """A board that comes sooner after the last one's end is not filmed."""
    lights: dict[str, LightConfig] = {}
    order: tuple[str, ...] = ()
    """Lights of the rows, in turn; empty: all in the order of the file. Without lights only cameras are fired."""

    @model_validator(mode="after")
    def _lights_exist(self) -> Self:
        if unknown := [name for name in self.order if name not in self.lights]:
            raise ValueError(f"order names the lights {unknown}, but there are {list(self.lights)}")
        return self

    @property
    def light_sequence(self) -> tuple[str, ...]:
        """Names of the lights of rows 0, 1, …, then from the start again."""
        return self.order or tuple(self.lights)


class SimulationConfig(Section):
    """The digital twin that stands in for line, cameras and controller."""

    scenario: Path
    boards: Annotated[Whole, Field(ge=0)] = 0
    """How many boards pass; 0: they keep coming."""
    interval_s: Positive = 5.0
    """Time between the leading edges of two boards, at least; frames are rendered beforehand."""


class ReplayConfig(Section):
    """Recordings that are played in place of line, cameras and controller."""

    recordings: Annotated[tuple[Path, ...], Field(min_length=1)]
    runs: Annotated[Whole, Field(ge=0)] = 0
    """How many runs are played, going round the recordings; 0: they keep coming."""
    pace: Literal["original", "fast"] = "original"
    """With the original timing, or as fast as the frames are taken."""
    pause_s: NotNegative = 1.0
    """Time between two runs at the original pace; a fast replay does not pause."""


class RingConfig(Section):
    """The shared memory for frames."""

    directory: Path = Path("/dev/shm")  # noqa: S108  (the ring is made exclusively, mode 0640)
    runs: Annotated[Whole, Field(ge=2, le=64)] = 3
    """Runs it holds at once; one is being filmed while others are used."""
    spare_rows: Annotated[Whole, Field(ge=0, le=64)] = 2
    """Slots per camera beyond the longest board, for frames nobody asked for."""
    lease_s: Positive = 600.0
    """A run that somebody holds is given up after this time without a sign of life."""


class ApiConfig(Section):
    """Where the REST service listens."""

    host: str = "127.0.0.1"
    port: Annotated[Whole, Field(ge=0, le=65535)] = 8350
    names: tuple[str, ...] = ()
    """Further names by which callers may address the station; loopback, the machine's own and addresses always do."""


class StationConfig(Section):
    """Everything the station is told before it starts."""

    name: str = "vaoi"
    calibration: Path
    board_types: Path
    """Directory of board types, NAME.json each."""
    data: Path
    """Directory for the database, results and kept recordings."""
    workers: Annotated[Whole, Field(ge=1, le=64)] = 2
    method: MethodName = "auto"
    """How runs are stitched whose board type has no way of its own; `auto` uses a reference where one was taught."""
    line: Line
    cameras: Annotated[tuple[CameraConfig, ...], Field(min_length=1)]
    controller: ControllerConfig = ControllerConfig()
    simulation: SimulationConfig | None = None
    replay: ReplayConfig | None = None
    ring: RingConfig = RingConfig()
    api: ApiConfig = ApiConfig()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [c.name for c in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"cameras have the names {names}; they must differ")
        for key in ("serial", "address"):
            given = [v for c in self.cameras if (v := getattr(c, key)) is not None]
            if twice := sorted({v for v in given if given.count(v) > 1}):
                raise ValueError(f"several cameras have the {key} {', '.join(twice)}; each is one camera's")
        wanted = CAMERAS_OF[self.controller.backend]
        if wrong := sorted({c.backend for c in self.cameras} - {wanted}):
            raise ValueError(
                f"backends are mixed: a controller with backend {self.controller.backend!r} "
                f"fires cameras with backend {wanted!r}, but there are {wrong}"
            )
        if self.controller.backend != "serial" and getattr(self, TABLE_OF[self.controller.backend]) is None:
            needed = TABLE_OF[self.controller.backend]
            raise ValueError(f"backend {self.controller.backend!r} needs a table [{needed}]")
        for camera in self.cameras:
            if camera.exposure_us * 1e-6 >= self.line.trigger_period_s:
                raise ValueError(
                    f"camera {camera.name!r} exposes {camera.exposure_us} us, "
                    f"but pulses follow every {self.line.trigger_period_s * 1e6:.0f} us"
                )
        return self

    @property
    def rows_per_run(self) -> int:
        """Slots per camera and run in the ring."""
        return self.line.rows_of_longest_board + self.ring.spare_rows


def read_config(path: Path) -> StationConfig:
    """Read `station.toml`; paths in it become absolute."""
    config = parse(StationConfig, read_toml(path), path)
    return config.model_copy(update=_absolute(config, path.resolve().parent))


def _absolute(section: BaseModel, base: Path) -> dict[str, Any]:
    """The paths of a section, and of the sections inside it, made relative to the file's directory."""
    changed: dict[str, Any] = {}
    for key in type(section).model_fields:
        value = getattr(section, key)
        if isinstance(value, Path):
            changed[key] = base / value
        elif isinstance(value, tuple) and value and isinstance(value[0], Path):
            changed[key] = tuple(base / p for p in value)
        elif isinstance(value, BaseModel) and (inner := _absolute(value, base)):
            changed[key] = value.model_copy(update=inner)
    return changed
