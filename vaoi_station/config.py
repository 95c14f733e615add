"""Read `station.toml` into one frozen `StationConfig`; refuse unknown keys and impossible values.

Relative paths in the file are relative to the file. Lengths along the line are in tester
coordinates (mm in the conveyor's plane, axes and origin of the calibration board).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, Field, model_validator

from vaoi_station.files.documents import parse, read_toml
from vaoi_station.line_config import Hermes, Line, NotNegative, Section, Smema
from vaoi_station.model import CameraHead, Finite, Positive, Program, Visibility, Whole
from vaoi_station.model.receivers import PushConfig
from vaoi_station.model.root_path import RootPath
from vaoi_station.pixel_formats import PIXEL_FORMATS, PixelFormatName

MethodName = Literal["auto", "fiducials", "features", "reference"]
"""Names of the stitching methods. The module `stitching.method` describes the evidence that each method uses."""
Pixels = Annotated[Whole, Field(ge=0)]
Word = Annotated[str, Field(min_length=1)]

CAMERAS_OF = {"simulated": "simulated", "replay": "replay", "serial": "aravis"}
"""For each backend of the controller, the backend of its cameras: a simulated pulse cannot fire a real camera."""
TABLE_OF = {"simulated": "simulation", "replay": "replay"}
"""For each controller backend without devices, the table that configures its scenario or recordings."""

CHUNK_ROOM_BYTES = 4096
"""Room for the chunk data of a frame. Exposure and gain take 40 bytes; what a camera adds always is some hundred."""

LONGEST_GAP_S = 2147.0
"""Longest gap, in whole seconds, of the protocol: 32 bits of ticks of 0.5 µs (hw/protocol.md)."""


def _as_list(features: Any) -> Any:
    return (features,) if isinstance(features, dict) else features


class CameraConfig(Section):
    """One camera of the array. The order of the cameras is that of the calibration."""

    name: str
    """Name in messages, in REST and on the page; each camera has another."""
    backend: Literal["simulated", "replay", "aravis"] = "simulated"
    """What takes its place: the twin, recordings, or none: it is a real camera (`aravis`)."""
    width: Annotated[Whole, Field(ge=16, le=65536)]
    """Columns of a frame, px."""
    height: Annotated[Whole, Field(ge=16, le=65536)]
    """Lines of a frame, px."""
    exposure_us: Positive
    """Exposure, unless a light program states another; shorter than the time between two pulses."""
    readout_us: NotNegative = 0.0
    """Time from the end of an exposure to the earliest next one; 0 for sensors that expose while they read out."""
    pixel_format: PixelFormatName = "Mono8"
    """Pixels of a frame by GenICam's names; cameras that are simulated or replayed send Mono8 or Mono16."""
    latency_us: NotNegative | None = None
    """Time from a pulse to the time stamp of its frame; None: it is learnt from the frames."""
    latency_gate_us: Positive = 10_000.0
    """Largest accepted difference between the latency of a frame and that of its camera."""
    serial: Word | None = None
    """Serial number of an Aravis camera."""
    address: Word | None = None
    """Instead of the serial number: IP address or host name, with which the camera is found without a search."""
    offset_px: tuple[Pixels, Pixels] = (0, 0)
    """Column and row of the sensor's pixel at which the frame begins."""
    gain_db: Finite = 0.0
    """Gain, unless a light program states another."""
    exposure_by: Literal["auto", "register", "trigger-width", "sequencer"] = "auto"
    """What sets the exposure of a real camera under a light program: its register, the same for all rows, or row by
    row the width of the trigger, or the camera's sequencer, with the gain too. `auto`: the register unless the program
    has rows of different exposure, and then the width of the trigger."""
    trigger_line: Word | None = None
    """Input of the camera to which the trigger is wired; None for the usual one of its vendor."""
    packet_bytes: Annotated[Whole, Field(ge=576, le=65535)] | None = None
    """Largest packet in bytes; None for what the way from the camera passes, at most 9000."""
    link: Word | None = None
    """Name of a link between camera and port that several cameras share, as the uplink of a switch; cameras with the
    same name share it."""
    link_mbit_s: Positive | None = None
    """Speed of `link`, without one of the port; None for the speed that the interface reports."""
    user_set: Word = "Default"
    """User set of the camera that is loaded before all settings; "keep" keeps what is in the camera."""
    ptp: bool = False
    """Whether the camera's clock follows a PTP master (IEEE 1588); otherwise PTP is switched off."""
    features: Annotated[tuple[dict[str, bool | Whole | Finite | str], ...], BeforeValidator(_as_list)] = Field(
        default=(), json_schema_extra={"type": "object"}
    )
    """Further settings by their GenICam names, written in this order before the trigger settings: one table, or a list
    of tables, in which a selector can be visited more than once."""
    nominal_center_mm: tuple[Finite, Finite] | None = None
    """Nominal centre of the camera's view, in tester coordinates, mm; calibration needs it to within a few mm."""
    nominal_px_per_mm: Positive | None = None
    """Nominal resolution on the belt; calibration needs it."""
    nominal_roll_deg: Annotated[Finite, Field(ge=-360, le=360)] | None = None
    """Rotation of the mounted camera, from image x towards image y; 180 is upside down. None: upright."""

    @property
    def label(self) -> str:
        """The camera's name in messages: "camera left", or the name itself if it begins with "camera"."""
        return self.name if self.name.lower().startswith("camera") else f"camera {self.name}"

    @property
    def named_features(self) -> tuple[tuple[str, bool | int | float | str], ...]:
        """The further settings in their order."""
        return tuple(pair for table in self.features for pair in table.items())

    @property
    def head(self) -> CameraHead:
        """The camera's entry in the head of a recording."""
        return CameraHead(
            width=self.width,
            height=self.height,
            exposure_us=self.exposure_us,
            nominal_center_mm=self.nominal_center_mm,
            nominal_px_per_mm=self.nominal_px_per_mm,
            nominal_roll_deg=self.nominal_roll_deg,
            # Frames of more than 8 bits leave the ring at full scale, whatever the depth of the camera.
            bits=16 if PIXEL_FORMATS[self.pixel_format].bits > 8 else None,
            serial=self.serial,
        )

    @property
    def frame_bytes(self) -> int:
        """Size of one frame in the ring, in bytes."""
        return PIXEL_FORMATS[self.pixel_format].nbytes(self.width, self.height)

    @property
    def chunk_room_bytes(self) -> int:
        """Room behind the pixels of each frame for its chunk data, which state exposure and gain; 0 if it has none."""
        return CHUNK_ROOM_BYTES if self.exposure_by == "sequencer" else 0

    @model_validator(mode="after")
    def _one_of_a_kind(self) -> Self:
        if self.link is not None and self.link_mbit_s is None:
            raise ValueError(f"camera {self.name!r} has the link {self.link!r} without its speed, link_mbit_s")
        if self.backend == "aravis":
            if (self.serial is None) == (self.address is None):
                raise ValueError(f"camera {self.name!r} needs a serial or an address, and not both")
            # With an odd offset, the colour of the first pixel is another one than the format says at some makes.
            if self.pixel_format.startswith("Bayer") and any(offset % 2 for offset in self.offset_px):
                raise ValueError(
                    f"camera {self.name!r} has pixel_format {self.pixel_format}, so offset_px must be even"
                )
        elif self.serial is not None or self.address is not None:
            raise ValueError(f"camera {self.name!r} has backend {self.backend!r}, which has no serial and no address")
        # Only frames of Aravis cameras are unpacked; the others are written to the ring as they are.
        elif not PIXEL_FORMATS[self.pixel_format].in_place:
            raise ValueError(f"camera {self.name!r} has backend {self.backend!r}, which sends Mono8 or Mono16 only")
        return self


class LightConfig(Section):
    """A light pattern: LED channels that are lit together, and their on-time."""

    channels: Annotated[tuple[Annotated[Whole, Field(ge=0, le=7)], ...], Field(min_length=1)]
    """LED channels of the controller, 0 … 7."""
    on_us: Positive
    """Time for which they are lit, from the pulse on."""


class ControllerConfig(Section):
    """The microcontroller that fires cameras and LEDs."""

    backend: Literal["simulated", "replay", "serial"] = "simulated"
    """What takes its place: the twin, recordings, or none: it is the real one (`serial`), for cameras with `aravis`."""
    port: Word = "/dev/vaoi-trigger"
    """Serial port by a name that does not change; deploy/71-vaoi-controller.rules creates this one."""
    baud: Annotated[Whole, Field(ge=9600, le=2_000_000)] = 250_000
    """Rate of the serial port, bit/s."""
    trigger_us: Annotated[Positive, Field(ge=50, le=2000)] = 100.0
    """Width of the camera trigger, within the limits of hw/protocol.md."""
    min_gap_s: Annotated[NotNegative, Field(le=LONGEST_GAP_S)] = 0.0
    """A board that arrives sooner after the end of the previous run is not filmed."""
    interlock: Literal["off", "on"] = "off"
    """Whether the output "line ready" lets the conveyor hold boards back while they would not be filmed well."""
    lights: dict[str, LightConfig] = Field(default={})
    """Light patterns by name."""
    order: tuple[str, ...] = ()
    """Lights of consecutive rows; empty for all in the order of the file. Without lights only cameras are triggered."""

    @model_validator(mode="after")
    def _lights_exist(self) -> Self:
        if unknown := [name for name in self.order if name not in self.lights]:
            raise ValueError(f"order names the lights {unknown}, but there are {list(self.lights)}")
        return self

    @model_validator(mode="after")
    def _interlock_has_an_output(self) -> Self:
        if self.interlock == "on" and self.backend == "replay":
            raise ValueError('interlock = "on" needs the backend "serial" or "simulated": a replay has no outputs')
        return self

    @property
    def light_sequence(self) -> tuple[str, ...]:
        """The names of the lights of rows 0, 1, …; after the last name the sequence begins again."""
        return self.order or tuple(self.lights)


class SimulationConfig(Section):
    """The digital twin that simulates line, cameras and controller."""

    scenario: Path
    """Scenario of the twin."""
    boards: Annotated[Whole, Field(ge=0)] = 0
    """Number of boards that pass; 0 for no end."""
    interval_s: Positive = 5.0
    """Minimum time between the leading edges of two boards; frames are rendered in advance."""


class ReplayConfig(Section):
    """Recordings that are replayed instead of line, cameras and controller."""

    recordings: Annotated[tuple[Path, ...], Field(min_length=1)]
    """Recordings, which are replayed in turn."""
    runs: Annotated[Whole, Field(ge=0)] = 0
    """Number of runs that are replayed, in a cycle over the recordings; 0 for no end."""
    pace: Literal["original", "fast"] = "original"
    """Timing of the replay: as in the recording, or as fast as frames are processed."""
    pause_s: NotNegative = 1.0
    """Pause between two runs at the original pace; a fast replay does not pause."""


class RingConfig(Section):
    """The ring, the shared memory for frames."""

    directory: Path = Path("/dev/shm")  # noqa: S108  (the ring is made exclusively, mode 0640)
    """Directory of the ring, in a file system that is memory."""
    runs: Annotated[Whole, Field(ge=2, le=64)] = 3
    """Number of runs that the ring holds at once; one is filmed while the others are used."""
    spare_rows: Annotated[Whole, Field(ge=0, le=64)] = 2
    """Slots per camera beyond the longest board, for unassigned frames."""
    lease_s: Positive = 600.0
    """Time after which a hold on a run ends, unless the caller renews it."""
    keep_s: Annotated[Finite, Field(ge=0.1, le=3600)] = 5.0
    """Time from the announcement of a run during which its frames are not evicted for the next board."""


class KeepConfig(Section):
    """Which data of finished runs are kept. Of older runs only a summary is kept, and of still older ones nothing.

    The defaults keep one year at a board every 20 s, within `database_gb`. Pinned runs are always kept whole.
    """

    results: Annotated[Whole, Field(ge=100)] = 100_000
    """Number of runs with verdict ok that are kept whole, with result, frame verdicts and timeline."""
    days: Positive = 60.0
    """Age in days beyond which a run with verdict ok is not kept whole."""
    doubtful_results: Annotated[Whole, Field(ge=100)] = 50_000
    """Number of degraded and failed runs that are kept whole."""
    doubtful_days: Positive = 400.0
    """Age in days beyond which a degraded or failed run is not kept whole."""
    runs: Annotated[Whole, Field(ge=1000)] = 2_000_000
    """Number of runs of which at least the summary is kept."""
    run_days: Positive = 400.0
    """Age in days beyond which no data of a run are kept."""
    database_gb: Annotated[Positive, Field(ge=0.05)] = 16.0
    """Size of the database, in 10^9 bytes, above which the oldest runs are deleted although other limits still keep
    them."""
    recordings_gb: NotNegative = 20.0
    """Size of the kept recordings of failed, degraded and pinned runs, in 10^9 bytes; 0 keeps none."""
    mosaics_gb: NotNegative = 1.0
    """Size of the kept pictures of whole boards, in 10^9 bytes; 0 keeps none."""
    recordings_of_failed: bool = True
    """Whether frames of failed and degraded runs are kept; those of pinned runs always are."""


class CameraPowerConfig(Section):
    """A command of the administrator that switches the power of one camera off and on, as at a switch with PoE."""

    command: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1)]
    """Absolute path of the program, and its arguments, in which {name}, {address} and {serial} stand for the camera's.
    It is run without a shell, and ends once the power is on again."""
    limit_s: Annotated[Positive, Field(le=600)] = 30.0
    """Longest time that the command may take; then it gets SIGTERM, and SIGKILL 5 s later."""

    @model_validator(mode="after")
    def _by_path(self) -> Self:
        if not Path(self.command[0]).is_absolute():
            raise ValueError(f"command begins with {self.command[0]!r}, but must begin with an absolute path")
        return self


class ArchiveConfig(Section):
    """The archive to which finished runs are handed: all that are kept as recordings, and some of the good ones."""

    url: Annotated[str, Field(min_length=1)]
    """Directory, or an address that fsspec knows. It must have been made by `vaoi archive create`."""
    ok_every: Annotated[Whole, Field(ge=0)] = 0
    """Of the runs with verdict ok about every n-th is archived, chosen by its id; 1: all, 0: pinned ones only."""
    mb_s: Annotated[Positive, Field(ge=0.1)] | None = None
    """Largest mean rate in 10^6 bytes per s; None: no limit."""


class ApiConfig(Section):
    """The address at which the REST service listens."""

    host: str = "127.0.0.1"
    """Address of REST and the page; 0.0.0.0 for all interfaces."""
    port: Annotated[Whole, Field(ge=0, le=65535)] = 8350
    """Port of REST and the page."""
    names: tuple[str, ...] = ()
    """Further host names by which callers may address the station, besides its own name and addresses."""
    root_path: RootPath = ""
    """Path under which a reverse proxy offers the station, if the proxy passes it on unchanged, such as /aoi."""
    open_loopback: bool = True
    """Whether programs on this machine may read, operate and teach without a key. All others need one."""
    certificate: Path | None = None
    """Certificate of the station with its chain (PEM); if it is given, the service accepts only TLS."""
    private_key: Path | None = None
    """Private key of the certificate (PEM)."""
    other_station: Annotated[str, Field(pattern=r"^https?://[^/?#@]+(/[^?#]*)?$")] | None = None
    """Address of the station that films the other side of the boards, http://HOST:PORT; both are shown as one."""
    other_station_key: Path | None = None
    """File with a key of that station, with the scope `read`; None: it is asked without a key."""
    other_station_ca: Path | None = None
    """Certificate that is trusted for that station (PEM); None: those of the system."""

    @model_validator(mode="after")
    def _both_or_none(self) -> Self:
        if (self.certificate is None) != (self.private_key is None):
            raise ValueError("certificate and private_key belong together; give both or none")
        return self


class StationConfig(Section):
    """The whole configuration of a station."""

    name: str = "vaoi"
    """Name of the station."""
    calibration: Path
    """calibration.json of the array."""
    flat_fields: Path | None = None
    """Directory of the flat fields of the cameras (`vaoi flatfield`); None: merged pictures are made without them."""
    board_types: Path
    """Directory of board types, one NAME.json each."""
    data: Path
    """Directory for the database, results and kept recordings."""
    workers: Annotated[Whole, Field(ge=1, le=64)] = 2
    """Number of worker processes."""
    method: MethodName = "auto"
    """Method for board types without a method of their own; `auto` uses a reference if there is one."""
    heights: Literal["after-run", "on-request"] = "after-run"
    """When heights of components are measured: after each run, or when a caller requests them."""
    line: Line
    cameras: Annotated[tuple[CameraConfig, ...], Field(min_length=1)]
    camera_power: CameraPowerConfig | None = None
    controller: ControllerConfig = ControllerConfig()
    simulation: SimulationConfig | None = None
    replay: ReplayConfig | None = None
    ring: RingConfig = RingConfig()
    api: ApiConfig = ApiConfig()
    keep: KeepConfig = KeepConfig()
    push: PushConfig = PushConfig()
    hermes: Hermes | None = None
    smema: Smema | None = None
    archive: ArchiveConfig | None = None
    program: Program = ()
    """Light, exposure and gain of the rows, in turn, unless the board type has a program."""
    visibility: Visibility = Visibility()
    """How much of every component the good frames of a run must show, unless its board type asks for something else."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        tables = {name for name in TABLE_OF.values() if getattr(self, name) is not None}
        if found := [*conflicts(self.cameras, self.controller, tables, self.line, self.hermes, self.smema)]:
            raise ValueError("; ".join(found))
        return self

    @property
    def rows_per_run(self) -> int:
        """Number of slots per camera and run in the ring."""
        return self.line.rows_of_longest_board + self.ring.spare_rows

    def with_serial(self, camera: int, serial: str) -> StationConfig:
        """Return the configuration with another real camera at a place, which is found by its serial number."""
        other = self.cameras[camera].model_copy(update={"serial": serial, "address": None})
        return self.model_copy(update={"cameras": (*self.cameras[:camera], other, *self.cameras[camera + 1 :])})

    @property
    def heads(self) -> tuple[CameraHead, ...]:
        """The camera heads of this station's recordings."""
        return tuple(camera.head for camera in self.cameras)

    @property
    def known_lights(self) -> tuple[str, ...]:
        """Lights of rows of board types without a program, in turn; empty if a twin or a recording decides, or none."""
        serial = self.controller.light_sequence if self.controller.backend == "serial" else ()
        return tuple(step.light for step in self.program) or serial


def conflicts(
    cameras: Sequence[CameraConfig],
    controller: ControllerConfig | None,
    tables: Set[str],
    line: Line | None,
    hermes: Hermes | None,
    smema: Smema | None = None,
) -> Iterator[str]:
    """Yield every contradiction between tables. A table that is not valid by itself is None and is not compared.

    `tables` has the names of the tables of `TABLE_OF` that are present.
    """
    # Names identify cameras in messages, in REST and on the page.
    names = [c.name for c in cameras]
    if len(set(names)) != len(names):
        yield f"cameras have the names {names}; they must differ"
    for key in ("serial", "address"):
        given = [v for c in cameras if (v := getattr(c, key)) is not None]
        if twice := sorted({v for v in given if given.count(v) > 1}):
            yield f"several cameras have the {key} {', '.join(twice)}; each may be given once"
    if controller is not None:
        wanted = CAMERAS_OF[controller.backend]
        if wrong := sorted({c.backend for c in cameras} - {wanted}):
            yield (
                f"backends are mixed: a controller with backend {controller.backend!r} "
                f"fires cameras with backend {wanted!r}, but there are {wrong}"
            )
        needed = TABLE_OF.get(controller.backend)
        if needed is not None and needed not in tables:
            yield f"backend {controller.backend!r} needs a table [{needed}]"
    if controller is not None and controller.backend == "replay" and line is not None and line.by_encoder:
        yield 'pacing = "encoder" needs the backend "serial" or "simulated": a replay has no encoder'
    # A sensor that still exposes ignores the next trigger, and every second frame would be missing.
    for camera in cameras:
        if line is not None and camera.exposure_us * 1e-6 >= line.shortest_period_s:
            yield (
                f"camera {camera.name!r} exposes {camera.exposure_us} us, "
                f"but pulses follow every {line.shortest_period_s * 1e6:.0f} us"
            )
    # A board that is given up while it moves may come nevertheless, and take the order of the board behind it.
    if line is not None and hermes is not None and hermes.longest_transfer_s(line) > line.transport_s[1]:
        yield (
            f"hermes.transfer_s is {hermes.transfer_s:g}, but a board is given up {line.transport_s[1]:g} s after its "
            "transport began, the second value of line.transport_s; it must be at least as long"
        )
    if smema is not None and controller is not None and controller.interlock == "off":
        yield '[smema] needs controller.interlock = "on": "machine ready" to the machine upstream is that output'
    # Two ways to offer one board could give it to the next machine twice.
    if smema is not None and smema.sides == "both" and hermes is not None and hermes.listen is not None:
        yield 'smema.sides = "both" and hermes.listen exclude each other: the next machine takes boards by one of them'


def read_config(path: Path) -> StationConfig:
    """Read `station.toml`, and make its paths absolute."""
    # Paths are relative to the file, not to the working directory, because systemd starts the service in /.
    config = parse(StationConfig, read_toml(path), path)
    return config.model_copy(update=absolute_paths(config, path.resolve().parent))


def absolute_paths(section: BaseModel, base: Path) -> dict[str, Any]:
    """Return the paths of a table and of its nested tables as absolute paths; relative ones begin at folder `base`."""
    changed: dict[str, Any] = {}
    for key in type(section).model_fields:
        # `vaoi check-config` constructs sections from which the faulty keys were removed.
        value = getattr(section, key, None)
        if isinstance(value, Path):
            changed[key] = base / value
        elif isinstance(value, tuple) and value and isinstance(value[0], Path):
            changed[key] = tuple(base / p for p in value)
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            inside = [absolute_paths(part, base) for part in value]
            if any(inside):
                changed[key] = tuple(v.model_copy(update=u) for v, u in zip(value, inside, strict=True))
        elif isinstance(value, BaseModel) and (inner := absolute_paths(value, base)):
            changed[key] = value.model_copy(update=inner)
    return changed
