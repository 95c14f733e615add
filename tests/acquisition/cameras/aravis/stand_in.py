"""A stand-in for an Aravis camera and its stream: features in a dictionary, no threads and no network."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.pixel_formats import PIXEL_FORMATS


class StandInError(Exception):
    """Takes the place of `GLib.Error`, which cannot be imported everywhere."""

    def __init__(self, message: str = "timed out.") -> None:
        super().__init__(f"domain: {message}")
        self.message = message


class BufferStatus(Enum):
    """The statuses that the package distinguishes."""

    SUCCESS = "success"
    CLEARED = "cleared"
    FILLING = "filling"
    MISSING_PACKETS = "missing-packets"
    NEW_ONE = "new-one"

    @property
    def value_nick(self) -> str:
        return self.value


class StandInBuffer:
    """A buffer of a stream; tests set what the receive thread would write."""

    def __init__(self, size: int, address: int) -> None:
        self.size, self.address = size, address
        self.status = BufferStatus.CLEARED
        self.frame = SimpleNamespace(
            width=16, height=16, code=PIXEL_FORMATS["Mono8"].code, id=7, time_ns=1_000,
            received=256, chunks=False, began_ns=1_000,
        )  # fmt: skip

    @classmethod
    def new(cls, size: int, address: int) -> StandInBuffer:
        return cls(size, address)

    def get_status(self) -> BufferStatus:
        return self.status

    def get_image_width(self) -> int:
        return int(self.frame.width)

    def get_image_height(self) -> int:
        return int(self.frame.height)

    def get_image_pixel_format(self) -> int:
        return int(self.frame.code)

    def get_frame_id(self) -> int:
        return int(self.frame.id)

    def get_timestamp(self) -> int:
        return int(self.frame.time_ns)

    def get_system_timestamp(self) -> int:
        return int(self.frame.began_ns)

    def has_chunks(self) -> bool:
        return bool(self.frame.chunks)


class StandInDevice:
    """The feature level of a camera."""

    def __init__(self, features: dict[str, Any]) -> None:
        self.features = features
        self.ignored: set[str] = set()
        """Features that keep their value whatever is written."""
        self.refused: set[str] = set()
        """Features whose access fails."""
        self.written: list[tuple[str, Any]] = []
        self.commands: list[str] = []
        self.modes: dict[str, str] = {}
        """Trigger that is not selected → its mode."""
        self.controlled = True
        self.tick_hz = 1_000_000_000
        self.registers: dict[int, int] = {}
        self.entries: dict[str, tuple[str, ...]] = {}
        """Entries of enumerations; by default the present one."""
        self.bounds: dict[str, tuple[float, float]] = {}
        """Limits of numbers."""
        self.units: dict[str, str] = {}
        self.steps: dict[str, int] = {}
        """Steps of integers; 1 by default."""

    def is_feature_available(self, feature: str) -> bool:
        return feature in self.features

    is_feature_implemented = is_feature_available

    def get_feature(self, feature: str) -> Node | None:
        return KINDS[type(self.features[feature])](self.units.get(feature)) if feature in self.features else None

    def dup_available_enumeration_feature_values_as_strings(self, feature: str) -> list[str]:
        return list(self.entries.get(feature, (self.features[feature],)))

    def get_float_feature_bounds(self, feature: str) -> tuple[float, float]:
        return self.bounds.get(feature, (0.0, 1e6))

    def get_integer_feature_bounds(self, feature: str) -> tuple[int, int]:
        low, high = self.bounds.get(feature, (0, 1 << 40))
        return int(low), int(high)

    def get_integer_feature_increment(self, feature: str) -> int:
        return self.steps.get(feature, 1)

    def read_register(self, address: int) -> int:
        return self.registers.get(address, 0)

    def write_register(self, address: int, value: int) -> None:
        self.registers[address] = value

    def is_controller(self) -> bool:
        return self.controlled

    def get_timestamp_tick_frequency(self) -> int:
        return self.tick_hz

    def execute_command(self, command: str) -> None:
        self._check(command)
        self.commands.append(command)

    def read(self, feature: str) -> Any:
        self._check(feature)
        return self.features[feature]

    def write(self, feature: str, value: Any) -> None:
        self._check(feature)
        if feature not in self.features:
            raise StandInError(f"node {feature} is not found")
        self.written.append((feature, value))
        if feature in self.ignored:
            return
        if feature == "TriggerSelector":
            # Every trigger has a mode of its own.
            self.modes[self.features[feature]] = self.features["TriggerMode"]
            self.features["TriggerMode"] = self.modes.get(value, "Off")
        self.features[feature] = value

    get_boolean_feature_value = get_integer_feature_value = read
    get_float_feature_value = get_string_feature_value = read
    set_boolean_feature_value = set_integer_feature_value = write
    set_float_feature_value = set_string_feature_value = write

    def _check(self, feature: str) -> None:
        if feature in self.refused:
            raise StandInError(f"{feature} is locked.")


class Node:
    """A feature of a description."""

    def __init__(self, unit: str | None = None) -> None:
        self.unit = unit

    def get_first_child(self) -> None:
        return None

    def get_unit(self) -> str | None:
        return self.unit

    def get_tooltip(self) -> str | None:
        return "" if self.unit is None else f"Exposure time in units of {self.unit}"

    def get_description(self) -> None:
        return None


class GcBoolean(Node):
    """A switch."""


class GcInteger(Node):
    """A whole number."""


class GcFloat(Node):
    """A number."""


class GcEnumeration(Node):
    """A choice."""


class GcCommand(Node):
    """A command."""


class GcString(Node):
    """A text."""


KINDS: dict[type, type[Node]] = {
    bool: GcBoolean, int: GcInteger, float: GcFloat, str: GcEnumeration, type(None): GcCommand,
}  # fmt: skip
"""Type of a value → kind of its feature."""


class StandInStream:
    """A stream that fills no buffer by itself."""

    def __init__(self) -> None:
        self.pushed: list[StandInBuffer] = []
        self.filled: list[StandInBuffer] = []
        self.running = True
        self.counters = {"n_completed_buffers": 0, "n_duplicated_packets": 0, "n_underruns": 0, "port": 4711}
        self.properties: dict[str, object] = {}
        self.fill_when_popped: Callable[[], None] = lambda: None
        """Called by the pulling thread before each pop."""

    def push_buffer(self, buffer: StandInBuffer) -> None:
        self.pushed.append(buffer)

    def timeout_pop_buffer(self, _timeout_us: int) -> StandInBuffer | None:
        self.fill_when_popped()
        return self.filled.pop(0) if self.filled else None

    def stop_thread(self, _delete_buffers: bool) -> None:
        self.running = False

    def start_thread(self) -> None:
        self.running = True

    def set_property(self, name: str, value: object) -> None:
        self.properties[name] = value

    def get_port(self) -> int:
        return self.counters["port"]

    def get_n_infos(self) -> int:
        return len(self.counters)

    def get_info_name(self, k: int) -> str:
        return list(self.counters)[k]

    def get_info_uint64_by_name(self, name: str) -> int:
        return self.counters[name]


class StandInCamera:
    """The camera level: a small GigE camera of 16 × 16 px that obeys every setting."""

    def __init__(self, vendor: str = "Acme", *, is_gige: bool = False) -> None:
        self.vendor, self.is_gige = vendor, is_gige
        self.device = StandInDevice(
            {
                "PixelFormat": "Mono16",
                "Width": 64,
                "Height": 64,
                "ExposureTime": 10_000.0,
                "Gain": 5.0,
                "BinningHorizontal": 2,
                "ExposureAuto": "Continuous",
                "GammaEnable": True,
                "ChunkModeActive": True,
                "PtpEnable": True,
                "GevIEEE1588": True,
                "AcquisitionMode": "SingleFrame",
                "TriggerSelector": "AcquisitionStart",
                "TriggerMode": "Off",
                "TriggerSource": "Software",
                "TriggerActivation": "FallingEdge",
                "GevSCPSPacketSize": 1400,
                "GevSCPD": 0,
                "TimestampLatchValue": 5_000_000_000,
                "TimestampLatch": None,
            }
        )
        self.device.entries = {
            "PixelFormat": ("Mono8", "Mono16"),
            "ExposureAuto": ("Off", "Continuous"),
            "AcquisitionMode": ("SingleFrame", "Continuous"),
            "TriggerSelector": ("FrameStart", "AcquisitionStart"),
            "TriggerMode": ("Off", "On"),
            "TriggerSource": ("Software", "Line0", "Line1", "Line2"),
            "TriggerActivation": ("RisingEdge", "FallingEdge"),
        }
        self.device.bounds = {"ExposureTime": (20.0, 100_000.0), "Gain": (0.0, 24.0)}
        self.stream = StandInStream()
        self.payload = 256
        self.running = True

    def is_gv_device(self) -> bool:
        return self.is_gige

    def get_device(self) -> StandInDevice:
        return self.device

    def get_vendor_name(self) -> str:
        return self.vendor

    def get_model_name(self) -> str:
        return "Model 1"

    def get_device_serial_number(self) -> str:
        return "S1"

    def get_payload(self) -> int:
        return self.payload

    def is_gain_available(self) -> bool:
        return "Gain" in self.device.features

    def is_feature_available(self, feature: str) -> bool:
        return self.device.is_feature_available(feature)

    def gv_set_stream_options(self, _options: object) -> None:
        pass

    def gv_set_packet_size_adjustment(self, _adjustment: object) -> None:
        pass

    def get_integer_bounds(self, feature: str) -> tuple[int, int]:
        low, high = self.device.bounds.get(feature, (220, 9000))
        return int(low), int(high)

    def get_integer_increment(self, _feature: str) -> int:
        return 4

    def create_stream(self, _callback: object, _data: object) -> StandInStream:
        return self.stream

    def start_acquisition(self) -> None:
        self.running = True

    def stop_acquisition(self) -> None:
        self.running = False


LIBRARY = SimpleNamespace(
    Buffer=StandInBuffer,
    BufferStatus=BufferStatus,
    GcBoolean=GcBoolean,
    GcCommand=GcCommand,
    GcEnumeration=GcEnumeration,
    GcFloat=GcFloat,
    GvPacketSizeAdjustment=SimpleNamespace(NEVER=0),
    GcInteger=GcInteger,
    GcString=GcString,
    GvStreamOption=SimpleNamespace(PACKET_SOCKET_DISABLED=1),
)
"""Takes the place of the module `gi.repository.Aravis`."""


def camera_config(**changes: object) -> CameraConfig:
    """The configuration of a camera of 16 × 16 px."""
    content = {
        "name": "c0",
        "backend": "aravis",
        "address": "127.0.0.1",
        "width": 16,
        "height": 16,
        "exposure_us": 250.0,
    }
    return CameraConfig.model_validate(content | changes)


def station_config(directory: Path, cameras: list[CameraConfig], period_s: float = 0.1) -> StationConfig:
    """The configuration of a station of these cameras, with its ring in a directory."""
    return StationConfig.model_validate(
        {
            "calibration": "calibration.json",
            "board_types": "types",
            "data": "data",
            "line": {
                "conveyor_mm_s": (0.0, 100.0),
                "barrier_mm": -40.0,
                "start_delay_s": 0.1,
                "trigger_period_s": period_s,
                "tail_s": 0.2,
                "longest_board_mm": 40.0,
            },
            "cameras": [camera.model_dump() for camera in cameras],
            "controller": {"backend": "serial"},
            "ring": {"directory": directory},
        }
    )
