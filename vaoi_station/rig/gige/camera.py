"""A GigE Vision camera that serves any description: triggers, exposure, frames and clocks, bound to its own nodes."""

from __future__ import annotations

import itertools
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from vaoi_station.rig.gige.device import ACCESS_DENIED, CLOCK_HIGH, PACKET_SIZE, Device
from vaoi_station.rig.gige.first_values import BOOTSTRAP_END
from vaoi_station.rig.gige.formula import Number
from vaoi_station.rig.gige.packets import IMAGE, Stream

Script = Callable[[list[bytes]], Sequence[bytes]]
"""Function that makes from the packets of a frame those that are sent, in their order."""
_Command = tuple[str, str, Number, dict[str, Number]]
"""Name, node with its value, the value that executes it, and selectors."""
_FRAME_TRIGGERS = ("FrameStart", "FrameBurstStart", "AcquisitionStart", "ExposureStart")
"""Triggers of which one edge gives one frame."""
_EXPOSURES = ("ExposureTime", "ExposureTimeAbs")
_CLOCKS = {
    "TimestampLatch": ("TimestampLatchValue", "Timestamp"), "GevTimestampControlLatch": ("GevTimestampValue",),
    "TimestampControlLatch": ("TimestampLatchValue", "Timestamp", "TimestampValue"),
}  # fmt: skip
"""Command that latches the time → features that may hold it."""
_LOCKED = ("Width", "Height", "OffsetX", "OffsetY", "PixelFormat")
"""Features that cannot be written while frames are acquired."""


def as_it_is(packets: list[bytes]) -> Sequence[bytes]:
    """Send all packets once, in order."""
    return packets


class Camera(Device):
    """One camera. `expose` sends the frame of an edge of its trigger input, in the thread of the caller."""

    def __init__(self, address: str, description: str, *, extended: bool = False, **device: Any) -> None:
        """Serve a camera; `extended`: frame ids have 64 bits, and packet ids 32."""
        self.extended, self.next_id, self.acquiring = extended, 1, False
        self.resend_script: Script = as_it_is
        """Makes from the packets that a client asks for again those that are sent."""
        self.resend_requests = 0
        self._sent: list[bytes] = []
        self._sending = threading.Lock()
        self._sets: dict[int, tuple[dict[int, bytes], dict[tuple[str, tuple[Number, ...]], bytes]]] = {}
        """User sets that were saved, by the value of UserSetSelector."""
        self._power_on: int | None = None
        """The user set that is loaded at power-on; None: the first values."""
        super().__init__(address, description, **device)

    def boot(self) -> None:
        """Begin anew: first values, or those of the user set that is loaded at power-on; frame ids from 1."""
        with self.lock:
            super().boot()
            self.next_id, self.acquiring = 1, False
            self._commands = self._bind_commands()
            if self._power_on is not None:
                self._load_set(self._power_on)
            self._update_payload()

    # --- what tests and the rig ask

    @property
    def armed(self) -> bool:
        """Whether a client controls the camera, has started it, and has turned its frame trigger on."""
        with self.lock:
            return self.controlled and self.acquiring and self.trigger() not in (None, "Software")

    @property
    def frame_trigger(self) -> str | None:
        """The trigger of a frame that is on; empty if the camera has one trigger only; None while none is on."""
        with self.lock:
            if "TriggerMode" not in self.features:
                return None
            entries = self._model.entries("TriggerSelector") if "TriggerSelector" in self.features else {}
            for name in [n for n in _FRAME_TRIGGERS if n in entries] or [""]:
                with self.features.selecting({"TriggerSelector": name} if name else {}):
                    if self.features.text("TriggerMode") == "On":
                        return name
            return None

    def trigger(self) -> str | None:
        """Return the source of the trigger that starts a frame; None while none is on."""
        name = self.frame_trigger
        if name is None or "TriggerSource" not in self.features:
            return name
        return str(self.value("TriggerSource", **({"TriggerSelector": name} if name else {})))

    def value(self, name: str, **selection: Number | str) -> Number | str:
        """Return the value of a feature in the camera's units; an enumeration's is the name of its entry."""
        with self.lock, self.features.selecting(selection):
            is_text = self._model.kind(name) in ("Enumeration", "String", "StringReg")
            return self.features.text(name) if is_text else self.features.value(name)

    def put(self, name: str, value: Number | str, **selection: Number | str) -> None:
        """Change a feature, as no client has asked for."""
        with self.lock, self.features.selecting(selection):
            self.features.put(name, value)
            self._update_payload()

    def save_as_power_on_set(self, entry: str) -> None:
        """Save all values in a user set that is loaded at power-on, as an earlier client has done it."""
        with self.lock:
            number = self._model.entries("UserSetSelector")[entry]
            self._power_on = number
            self._sets[number] = self.registers.copy(), dict(self.features.banks)

    def selecting(self, at: Mapping[str, Number | str]) -> AbstractContextManager[None]:
        """Let selectors stand elsewhere for a while."""
        return self.features.selecting(at)

    def selections(self, name: str) -> list[dict[str, Number | str]]:
        """Return all settings of a feature's selectors, by the names of their entries; none without the feature."""
        with self.lock:
            if name not in self.features:
                return []
            found = []
            for numbers in self.features.selections(name):
                with self.features.selecting(numbers):
                    found.append({selector: self.value(selector) for selector in numbers})
            return found

    def kind(self, name: str) -> str:
        """Return the kind of a feature: `Enumeration`, `Boolean` …; empty if there is none."""
        return self._model.kind(name)

    def limits(self, name: str) -> tuple[float, float]:
        """Return the smallest and the largest value of a number now."""
        with self.lock:
            low, high, _ = self.features.limits(name)
            return float(low), float(high)

    def offers(self, name: str) -> bool:
        """Whether the camera has a feature now."""
        with self.lock:
            conditions = ("pIsImplemented", "pIsAvailable")
            return name in self.features and all(self.features.allows(name, tag) for tag in conditions)

    def entries(self, name: str) -> list[str]:
        """Return the entries of an enumeration that the camera has now."""
        with self.lock:
            return [e for e in self._model.entries(name) if self.features.allows_entry(name, e)]

    @property
    def exposure_us(self) -> float:
        """The exposure time of the next frame."""
        with self.lock:
            name = next((n for n in _EXPOSURES if n in self.features), "ExposureTimeRaw")
            return float(self.features.value(name)) if name in self.features else 0.0

    @property
    def stream(self) -> Stream:
        """What a client has set for the stream."""
        with self.lock:
            width, height, x, y = (int(self._geometry(n)) for n in ("Width", "Height", "OffsetX", "OffsetY"))
            size = self.number(PACKET_SIZE) & 0xFFFF
            code = (
                int(self.features.value("PixelFormat")) & 0xFFFFFFFF if "PixelFormat" in self.features else 0x01080001
            )
            return Stream(width, height, size, self.extended, code, (x, y))

    @property
    def payload_bytes(self) -> int:
        """Bytes of a frame."""
        stream = self.stream
        return -(-stream.width * stream.height * max(stream.pixel_format >> 16 & 0xFF, 8) // 8)

    def expose(self, pixels: bytes | memoryview, script: Script = as_it_is, edge_ns: int | None = None) -> int:
        """Send the frame of a trigger edge; return its id. A camera that is not armed sends nothing: 0.

        Args:
            pixels: all bytes of the frame.
            script: makes the packets that are sent.
            edge_ns: monotonic time of the edge; None: now.
        """
        if not self.armed:
            return 0
        with self.lock:
            self.ptp.advance()
        time_ns = self.clock_offset_ns + (time.monotonic_ns() if edge_ns is None else edge_ns)
        time_ns += round(self.trigger_delay_us * 1000)
        number, self.next_id = self.next_id, self.next_id + 1
        if self.next_id > (2**64 - 1 if self.extended else 65535):
            self.next_id = 1
        content, kind = self.framed(pixels)
        packets = self.stream.frame(content, number, self.ticks(time_ns), kind)
        # Packets are sent again only after the frame, as a camera does it between two frames.
        with self._sending:
            self._sent = packets
            self.send(script(packets))
        return number

    def framed(self, pixels: bytes | memoryview) -> tuple[bytes | memoryview, int]:
        """Return what follows the leader of a frame, and the type of this payload."""
        return pixels, IMAGE

    @property
    def trigger_delay_us(self) -> float:
        """The delay of the frame trigger."""
        with self.lock:
            for name in ("TriggerDelay", "TriggerDelayAbs"):
                if name in self.features:
                    entries = self._model.entries("TriggerSelector") if "TriggerSelector" in self.features else {}
                    chosen = next((n for n in _FRAME_TRIGGERS if n in entries), None)
                    with self.features.selecting({"TriggerSelector": chosen} if chosen else {}):
                        return float(self.features.value(name))
        return 0.0

    # --- what the registers do

    def refusal(self, address: int) -> int:
        """Refuse what the faults say, and a change of the geometry while frames are acquired."""
        if self.acquiring and any(self.is_at(name, address) for name in _LOCKED):
            return ACCESS_DENIED
        return super().refusal(address)

    def on_release(self) -> None:
        """Stop: a camera without a client sends nothing."""
        self.acquiring = False

    def on_write(self, address: int) -> None:
        """Execute the commands that a write has set."""
        if address < BOOTSTRAP_END:
            return
        for name, inner, number, selection in self._commands.get(address, ()):
            with self.features.selecting(selection):
                is_set = self.features.value(inner) == number
            if is_set:
                self._execute(name, inner, selection)
        if not self.acquiring:
            self._update_payload()

    def resend(self, content: bytes, *, extended: bool) -> None:
        """Send packets of the last frame again."""
        first, last = (n & (0xFFFFFFFF if extended else 0xFFFFFF) for n in struct.unpack_from(">II", content, 4))
        self.resend_requests += last - first + 1
        with self._sending:
            self.send(self.resend_script(self._sent[first : last + 1]))

    def _bind_commands(self) -> dict[int, list[_Command]]:
        """Return address → the commands that a write there may execute."""
        bound: dict[int, list[_Command]] = {}
        for name, node in self._model.nodes.items():
            inner = node.findtext("pValue") if node.tag == "Command" else None
            if inner is None or inner.strip() not in self.features:
                continue
            by_node = node.findtext("pCommandValue")
            text = self._model.text_of(name, "CommandValue")
            number = self.features.value(by_node.strip()) if by_node is not None else int(text or "1", 0)
            for selection in itertools.islice(self.features.selections(name, hidden=True), 16):
                with self.features.selecting(selection):
                    register = self.features.register_of(name)
                    if register is not None and self.features.on_device(register):
                        at = self.features.address(register)
                        bound.setdefault(at, []).append((name, inner.strip(), number, selection))
        return bound

    def _execute(self, command: str, inner: str, selection: dict[str, Number]) -> None:
        self.cure(command)
        if command == "AcquisitionStart":
            self.acquiring = True
        elif command in ("AcquisitionStop", "AcquisitionAbort"):
            self.acquiring = False
        elif command in _CLOCKS:
            # Some descriptions make the value of the bootstrap registers (Basler-a2A2600-20gmBAS).
            self.registers.write(CLOCK_HIGH, self.ticks(self.time_ns()).to_bytes(8, "big"))
            self.features.forget()
            for name in _CLOCKS[command]:
                if name in self.features and self.features.register_of(name) is not None:
                    self.features.put(str(self.features.register_of(name)), self.ticks(self.time_ns()))
                    break
        elif command in ("PtpDataSetLatch", "GevIEEE1588DataSetLatch"):
            self.ptp.latch(command)
        elif command in ("TimestampReset", "GevTimestampControlReset"):
            self.clock_offset_ns = -time.monotonic_ns()
        elif command == "UserSetLoad":
            self._load_set(int(self.features.value("UserSetSelector")))
        elif command == "UserSetSave":
            self._sets[int(self.features.value("UserSetSelector"))] = self.registers.copy(), dict(self.features.banks)
        elif command == "DeviceReset":
            self.reset()
            return
        if command not in ("AcquisitionStart", *_CLOCKS):
            with self.features.selecting(selection):
                self.features.put(inner, 0)  # it clears itself: a client may ask whether it is done

    def _load_set(self, number: int) -> None:
        """Restore a user set; those that were never saved are the first values."""
        assert self._first is not None
        pages, banks = self._sets.get(number, self._first)
        before = self.features.value("UserSetSelector") if "UserSetSelector" in self.features else 0
        self.registers.restore(pages, BOOTSTRAP_END)
        self.features.banks = dict(banks)
        self.features.forget()
        if "UserSetSelector" in self.features:
            self.features.put("UserSetSelector", before)

    def _geometry(self, name: str) -> Number:
        return self.features.value(name) if name in self.features else 0

    def _update_payload(self) -> None:
        """State the payload in the register that holds it, or in one of those of which a formula makes it."""
        if "PayloadSize" not in self.features:
            return
        wanted = self.payload_bytes
        for register in self.features.read_by("PayloadSize"):
            if self.features.value("PayloadSize") == wanted:
                return
            before = self.features.value(register)
            if self._model.text_of(register, "AccessMode") != "RO":
                continue
            self.features.put(register, wanted)
            if self.features.value("PayloadSize") != wanted:
                self.features.put(register, before)
