"""The rig's camera with chunk data and a sequencer, scripted by a test: real GVCP and GVSP on a loopback address."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from tests.gige.sequencer import Sequencer
from vaoi_station.rig.gige import camera as rig
from vaoi_station.rig.gige.camera import Script, as_it_is
from vaoi_station.rig.gige.device import ACCESS_DENIED
from vaoi_station.rig.gige.first_values import Sensor
from vaoi_station.rig.gige.packets import IMAGE, WITH_CHUNKS
from vaoi_station.rig.virtual_camera import OWN_DESCRIPTION, read_description

CHUNKS = {"ExposureTime": 0xE1, "Gain": 0xE2}
"""Entry of ChunkSelector → id of the chunk."""
IMAGE_CHUNK = 0xE0
SETS = 4
"""Sets that the sequencer holds."""
SEQUENCER = (
    "SequencerMode", "SequencerConfigurationMode", "SequencerTriggerSource", "SequencerSetSelector",
    "SequencerSetNext", "SequencerSetStart", "SequencerSetSave", "SequencerSetLoad",
)  # fmt: skip
_FIRST_ADDRESS = 0xB000


def description(*, chunks: bool, sequencer: bool) -> str:
    """Return the description of the rig's camera with chunk data, and with a sequencer."""
    nodes: dict[str, str] = {}
    if chunks or sequencer:
        nodes["ChunkModeActive"] = "<Boolean {}><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
        nodes["ChunkEnable"] = nodes["ChunkModeActive"]
        nodes["ChunkSelector"] = f"<Enumeration {{}}>{_entries(CHUNKS)}<pSelected>ChunkEnable</pSelected></Enumeration>"
    if sequencer:
        for name in SEQUENCER:
            choice = ("Off", "FrameStart" if name == "SequencerTriggerSource" else "On")
            nodes[name] = f"<Integer {{}}><Min>0</Min><Max>{SETS - 1}</Max><Inc>1</Inc></Integer>"
            if name.endswith(("Mode", "Source")):
                nodes[name] = f"<Enumeration {{}}>{_entries(choice)}</Enumeration>"
            elif name.endswith(("Save", "Load")):
                nodes[name] = "<Command {}><CommandValue>1</CommandValue></Command>"
    made = [
        text.replace(" {}>", f' Name="{name}"><pValue>{name}Register</pValue>')
        + f'<IntReg Name="{name}Register"><Address>{_FIRST_ADDRESS + 16 * k:#x}</Address><Length>4</Length>'
        "<AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
        for k, (name, text) in enumerate(nodes.items())
    ]
    if nodes:
        made += [
            f'<FloatReg Name="Chunk{name}"><Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode>'
            f'<pPort>Chunk{name}Port</pPort><Endianess>BigEndian</Endianess></FloatReg><Port Name="Chunk{name}Port">'
            f"<ChunkID>{number:X}</ChunkID></Port>"
            for name, number in CHUNKS.items()
        ]
    listed = "".join(f"<pFeature>{name}</pFeature>" for name in nodes)
    text = read_description(OWN_DESCRIPTION).replace("</Category>", f"{listed}</Category>", 1)
    return text.replace('<Port Name="Device"/>', f'{"".join(made)}<Port Name="Device"/>')


def _entries(names: Iterable[str]) -> str:
    return "".join(f'<EnumEntry Name="{name}"><Value>{k}</Value></EnumEntry>' for k, name in enumerate(names))


class Camera(rig.Camera):
    """One camera. `expose` sends frames in the thread of the caller."""

    def __init__(
        self,
        address: str,
        serial: str = "GIGE",
        *,
        extended: bool = False,
        chunks: bool = False,
        sequencer: bool = False,
    ) -> None:
        """Serve the camera.

        Args:
            address: local address.
            serial: serial number.
            extended: whether frame ids and packet ids have 64 and 32 bits.
            chunks: whether the camera adds chunk data to frames, unless a client turns them off.
            sequencer: whether it has a sequencer, and chunk data that a client may turn on.
        """
        self._adds_chunks = chunks
        text = description(chunks=chunks, sequencer=sequencer)
        super().__init__(address, text, serial=serial, sensor=Sensor(640, 480), extended=extended)

    def boot(self) -> None:
        """Begin anew, also the sequencer."""
        self.sequencer = Sequencer()
        super().boot()
        present = [name for name in SEQUENCER if name in self.features]
        self._sequencer_at = {self.features.address(f"{name}Register"): name for name in present}
        if self._adds_chunks:
            self.put("ChunkModeActive", 1)

    @property
    def has_chunks(self) -> bool:
        """Whether chunk data follow the pixels of a frame."""
        return "ChunkModeActive" in self.features and bool(self.value("ChunkModeActive"))

    @property
    def shutter(self) -> tuple[float, float]:
        """Exposure (µs) and gain (dB) of the next frame: those of the sequencer's set, or of the features."""
        return self.sequencer.active or (self._get("ExposureTime"), self._get("Gain"))

    @property
    def payload_bytes(self) -> int:
        """Bytes of a frame with its chunk data."""
        pixels = super().payload_bytes
        return pixels + len(self._chunk_data(pixels))

    def framed(self, pixels: bytes | memoryview) -> tuple[bytes | memoryview, int]:
        """Add chunk data to the pixels."""
        if not self.has_chunks:
            return pixels, IMAGE
        return bytes(pixels) + self._chunk_data(len(pixels)), IMAGE | WITH_CHUNKS

    def expose(self, pixels: bytes | memoryview, script: Script = as_it_is, edge_ns: int | None = None) -> int:
        """Send the frame of a trigger edge, and go to the next set of the sequencer."""
        number = super().expose(pixels, script, edge_ns)
        if number:
            self.sequencer.advance()
        return number

    def film(self, scene: bytes, edge_ns: int) -> int:
        """Send a frame of a scene of grey levels per 100 µs at gain 1, with the camera's exposure and gain."""
        exposure_us, gain_db = self.shutter
        factor = exposure_us / 100 * 10 ** (gain_db / 20)
        return self.expose(bytes(min(255, round(value * factor)) for value in scene), edge_ns=edge_ns)

    def refusal(self, address: int) -> int:
        """Lock the sequencer while frames are acquired, and as it says itself."""
        name = self._sequencer_at.get(address)
        locked = name is not None and (self.acquiring or self.sequencer.refuses(name, self._get))
        return ACCESS_DENIED if locked else super().refusal(address)

    def on_write(self, address: int) -> None:
        """Let the sequencer react."""
        super().on_write(address)
        if (name := self._sequencer_at.get(address)) is not None:
            self.sequencer.write(name, self._get, self.features.put)

    def _get(self, name: str) -> float:
        return self.features.value(name)

    def _chunk_data(self, pixels: int) -> bytes:
        """Return the chunk data behind a number of pixels: each chunk is followed by its id and its length."""
        if not self.has_chunks:
            return b""
        values = dict(zip(CHUNKS, self.shutter, strict=True))
        enabled = [name for name in CHUNKS if self.value("ChunkEnable", ChunkSelector=name)]
        return struct.pack(">II", IMAGE_CHUNK, pixels) + b"".join(
            struct.pack(">dII", values[name], CHUNKS[name], 8) for name in enabled
        )
