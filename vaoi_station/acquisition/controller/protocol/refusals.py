"""Check the controller's identity, and describe its refusals as sentences."""

from __future__ import annotations

from vaoi_station.acquisition.controller.protocol.messages import VERSION, Ident, Nak, Reason, State, Type
from vaoi_station.errors import DeviceError

BOARD = b"m328p16"
"""Name of the board type that this station drives: an ATmega328P at 16 MHz."""
OLDEST_FIRMWARE = (1, 1, 0)
OLDEST_PROTOCOL = (1, 1)
_FLASH = "Write the firmware that came with this station: make -C hw/firmware flash."
_FIELDS = (
    "pacing",
    "steps",
    "max_rows",
    "start_delay",
    "period",
    "tail",
    "min_period",
    "debounce",
    "min_gap",
    "trigger_width",
)
_FIRST_STEP = 16


def check_ident(payload: bytes) -> Ident:
    """Read the reply to IDENT. Raise DeviceError for any other device, and for firmware that is too old."""
    # The first two bytes are the protocol's version in every version of the protocol; the rest may differ.
    if payload[:1] != bytes([VERSION[0]]):
        spoken = ".".join(str(number) for number in payload[:2])
        raise DeviceError(
            f"The controller speaks protocol {spoken}, this station {VERSION[0]}.{VERSION[1]}.",
            action=_FLASH,
            code="protocol-version",
        )
    ident = Ident.unpack(payload)
    board = ident.board.rstrip(b"\0")
    if board != BOARD:
        raise DeviceError(
            f"The device on the controller's port calls itself {board!r}, but must be {BOARD!r}.",
            action="Check which device the port leads to.",
            code="foreign-device",
        )
    firmware = (ident.firmware_major, ident.firmware_minor, ident.firmware_patch)
    if firmware < OLDEST_FIRMWARE or ident.minor < OLDEST_PROTOCOL[1]:
        raise DeviceError(
            f"The controller has firmware {_dotted(firmware)} with protocol {ident.major}.{ident.minor}, but needs "
            f"{_dotted(OLDEST_FIRMWARE)} with {_dotted(OLDEST_PROTOCOL)} at least.",
            action=_FLASH,
            code="firmware-too-old",
        )
    return ident


def check_interlock(ident: Ident) -> None:
    """Raise DeviceError if the firmware has no output "line ready"."""
    if not ident.ready_longest_ms:
        firmware = (ident.firmware_major, ident.firmware_minor, ident.firmware_patch)
        raise DeviceError(
            f"The controller has firmware {_dotted(firmware)}, which has no output 'line ready', but [controller] "
            'interlock in station.toml is "on".',
            action=f'{_FLASH} Or set interlock = "off", and hold boards back by another way.',
            code="interlock-missing",
        )


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(str(number) for number in version)


def describe(nak: Nak) -> str:
    """Return a sentence that states why the controller refused a request, with the field and its limit."""
    request = Type(nak.request).name if nak.request in set(Type) else f"request {nak.request:#04x}"
    texts = {
        Reason.UNKNOWN: "this firmware does not know it",
        Reason.LENGTH: f"its payload must have {nak.limit} bytes",
        Reason.RANGE: f"{_field(nak)} is out of range, the nearest allowed value is {nak.limit}",
        Reason.LED_LIMIT: f"{_field(nak)} asks more of the LEDs than their limit of {nak.limit} ticks",
        Reason.STATE: f"the controller is {State(nak.limit).name if nak.limit in set(State) else nak.limit}",
        Reason.CHECKSUM: f"the checksum of the controller's configuration is {nak.limit:#010x}",
        Reason.LED_BUDGET: f"the LEDs of channel {nak.field} have not cooled down",
        Reason.GONE: f"the oldest event it still has is number {nak.limit}",
        Reason.UNCONFIGURED: "it has no configuration since its reset",
    }
    return f"{request} was refused: {texts.get(Reason(nak.reason)) if nak.reason in set(Reason) else nak.reason}."


def _field(nak: Nak) -> str:
    if nak.request == Type.COMMIT:
        return f"step {nak.field - _FIRST_STEP}" if nak.field >= _FIRST_STEP else _FIELDS[nak.field % len(_FIELDS)]
    # Only COMMIT numbers its fields; other requests have one value that can be out of range.
    names: dict[int, str] = {Type.STEP: "its index", Type.FIRE_ONE: "its pulse", Type.READY: "its time"}
    return names.get(nak.request, f"field {nak.field}")
