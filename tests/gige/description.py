"""The GenICam description of the test camera: what a station sets and reads, and nothing else."""

from __future__ import annotations

FIRST_FEATURE = 0x8000
_FORMATS = {"Mono8": 0x01080001}
_CHOICES = {
    "PixelFormat": _FORMATS,
    "AcquisitionMode": {"Continuous": 0},
    "TriggerSelector": {"FrameStart": 0},
    "TriggerMode": {"Off": 0, "On": 1},
    "TriggerSource": {"Software": 0, "Line0": 1},
    "TriggerActivation": {"RisingEdge": 0},
}
CHUNKS = {"ExposureTime": 0xE1, "Gain": 0xE2}
"""Entry of ChunkSelector → id of the chunk."""
_CHUNK_CHOICES = {"ChunkSelector": {name: k for k, name in enumerate(CHUNKS)}}
SETS = 4
"""Sets that the sequencer holds."""
_ON_OFF = {"Off": 0, "On": 1}
_SEQUENCER_CHOICES = {
    "SequencerMode": _ON_OFF,
    "SequencerConfigurationMode": _ON_OFF,
    "SequencerTriggerSource": {"Off": 0, "FrameStart": 1},
}
_SEQUENCER_NUMBERS = {
    "SequencerSetSelector": (0, SETS - 1, 1),
    "SequencerSetNext": (0, SETS - 1, 1),
    "SequencerSetStart": (0, SETS - 1, 1),
}
_SEQUENCER_COMMANDS = ("SequencerSetSave", "SequencerSetLoad")
_NUMBERS = {
    "Width": (8, 640, 8), "Height": (1, 480, 1), "OffsetX": (0, 640, 1), "OffsetY": (0, 480, 1),
    "PayloadSize": (0, 1 << 24, 1), "ExposureTimeRaw": (1, 1_000_000, 1), "GainCentibel": (0, 2400, 1),
}  # fmt: skip
"""Integer feature → smallest value, largest value, step."""
_COMMANDS = ("AcquisitionStart", "AcquisitionStop", "TimestampLatch", "DeviceReset")
_EIGHT_BYTES = "TimestampLatchValue"
_SWITCHES = ("ChunkModeActive", "ChunkEnable")
ADDRESSES = {
    name: FIRST_FEATURE + 16 * k
    for k, name in enumerate(
        (*_CHOICES, *_NUMBERS, *_COMMANDS, _EIGHT_BYTES, *_SWITCHES, *_CHUNK_CHOICES,
         *_SEQUENCER_CHOICES, *_SEQUENCER_NUMBERS, *_SEQUENCER_COMMANDS)
    )
}  # fmt: skip
"""Feature → address of its register."""
VENDOR_ADDRESS, MODEL_ADDRESS, SERIAL_ADDRESS = 0x48, 0x68, 0xD8
PACKET_SIZE_ADDRESS = 0xD04


def description(*, chunks: bool, sequencer: bool = False) -> str:
    """Return the description; with `chunks` the camera has chunk data, with `sequencer` a gain and a sequencer too."""
    nodes = [_register(name, ADDRESSES[name], 8 if name == _EIGHT_BYTES else 4) for name in ADDRESSES]
    choices, numbers, commands = dict(_CHOICES), dict(_NUMBERS), list(_COMMANDS)
    if chunks:
        choices |= _CHUNK_CHOICES
    if sequencer:
        choices |= _SEQUENCER_CHOICES
        numbers |= _SEQUENCER_NUMBERS
        commands += _SEQUENCER_COMMANDS
    for name, entries in choices.items():
        inner = "".join(f'<EnumEntry Name="{e}"><Value>{v}</Value></EnumEntry>' for e, v in entries.items())
        nodes.append(f'<Enumeration Name="{name}">{inner}<pValue>{name}Register</pValue></Enumeration>')
    nodes += [_integer(name, f"{name}Register", *limits) for name, limits in numbers.items()]
    for name in commands:
        nodes.append(f'<Command Name="{name}"><pValue>{name}Register</pValue><CommandValue>1</CommandValue></Command>')
    nodes.append(_integer(_EIGHT_BYTES, f"{_EIGHT_BYTES}Register", 0, (1 << 63) - 1, 1))
    nodes.append(
        '<Converter Name="ExposureTime"><FormulaTo>FROM</FormulaTo><FormulaFrom>TO</FormulaFrom>'
        "<pValue>ExposureTimeRaw</pValue></Converter>"
    )
    if sequencer:
        nodes.append(
            '<Converter Name="Gain"><FormulaTo>FROM * 100</FormulaTo><FormulaFrom>TO / 100</FormulaFrom>'
            "<pValue>GainCentibel</pValue></Converter>"
        )
    if chunks:
        nodes += [
            f'<Boolean Name="{name}"><pValue>{name}Register</pValue>'
            "<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
            for name in _SWITCHES
        ]
        nodes += [
            f'<FloatReg Name="Chunk{name}"><Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode>'
            f'<pPort>Chunk{name}Port</pPort><Endianess>BigEndian</Endianess></FloatReg><Port Name="Chunk{name}Port">'
            f"<ChunkID>{number:X}</ChunkID></Port>"
            for name, number in CHUNKS.items()
        ]
    nodes.append(
        f'<MaskedIntReg Name="PacketSizeRegister"><Address>{PACKET_SIZE_ADDRESS}</Address><Length>4</Length>'
        "<AccessMode>RW</AccessMode><pPort>Device</pPort><LSB>31</LSB><MSB>16</MSB><Sign>Unsigned</Sign>"
        "<Endianess>BigEndian</Endianess></MaskedIntReg>"
    )
    nodes.append(_integer("GevSCPSPacketSize", "PacketSizeRegister", 220, 9000, 4))
    texts = {"DeviceVendorName": (VENDOR_ADDRESS, 32), "DeviceModelName": (MODEL_ADDRESS, 32)}
    for name, (address, size) in (texts | {"DeviceSerialNumber": (SERIAL_ADDRESS, 16)}).items():
        nodes.append(
            f'<StringReg Name="{name}"><Address>{address}</Address><Length>{size}</Length>'
            "<AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
        )
    names = [*choices, *numbers, *commands, _EIGHT_BYTES, "ExposureTime", "GevSCPSPacketSize", *texts]
    root = "".join(f"<pFeature>{name}</pFeature>" for name in names)
    return (
        '<RegisterDescription ModelName="Test" VendorName="Test" StandardNameSpace="GEV" SchemaMajorVersion="1" '
        'SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0">'
        f'<Category Name="Root">{root}</Category>{"".join(nodes)}<Port Name="Device"/></RegisterDescription>'
    )


def _register(name: str, address: int, size: int) -> str:
    return (
        f'<IntReg Name="{name}Register"><Address>{address}</Address><Length>{size}</Length><AccessMode>RW</AccessMode>'
        "<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
    )


def _integer(name: str, register: str, low: int, high: int, step: int) -> str:
    limits = f"<Min>{low}</Min><Max>{high}</Max><Inc>{step}</Inc>"
    return f'<Integer Name="{name}"><pValue>{register}</pValue>{limits}</Integer>'
