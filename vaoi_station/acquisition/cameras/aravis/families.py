"""What cameras are, as a data sheet: neutral values, names, units, inputs and formulas, each with its source.

What a description states decides. A family appears only where its descriptions cannot say something. The sources are
descriptions of areaDetector/ADGenICam (folder xml, by file name) and documents of the makers (by number or title).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Word:
    """A wanted value that is written differently for each kind of feature."""

    text: str


OFF: Final = Word("off")
"""False, the first entry of `OFF_ENTRIES` that the camera offers, or 0."""
ON: Final = Word("on")
"""True, or the first entry of `ON_ENTRIES` that the camera offers."""
LEAST: Final = Word("least")
"""The lowest value that the camera states."""
OFF_ENTRIES = ("Off", "OFF", "Disabled", "None", "False", "BinOff")
ON_ENTRIES = ("On", "ON", "Enabled", "True")

Wanted = Word | float | tuple[str, ...]
"""A word, a number, or the accepted entries in order of preference."""


@dataclass(frozen=True)
class Neutral:
    """Features with their neutral value, and what another value would do to pictures or times."""

    names: tuple[str, ...]
    value: Wanted
    why: str
    per: str = ""
    """Selector, for each of whose entries the features have a value of their own."""
    unless: tuple[str, ...] = ()
    """Switches: a camera that has one of them needs no neutral value here."""


MODES = (
    # Basler-acA1300-75gm locks SequenceEnable while SequenceConfigurationMode is On; so do SFNC's.
    Neutral(
        (
            "SequencerConfigurationMode",
            "SequenceConfigurationMode",
            "SequenceConfigurationEnable",
            "SequencerMode",
            "SequenceEnable",
        ),
        OFF,
        "exposure and gain would change from frame to frame",
    ),
    # FLIR_BFLY_PGE_13H2M; ViewWorks_VNP604; Basler-acA1300-30gm.
    Neutral(("pgrHDRModeEnabled",), OFF, "four exposures would alternate"),
    Neutral(("MultishotEnable", "EnableBurstAcquisition"), OFF, "one pulse could give several frames"),
    Neutral(
        ("AcquisitionBurstFrameCount", "TriggerFrameCount", "triggerFrameCount"), 1, "one pulse would give many frames"
    ),
    Neutral(("DeviceScanType",), ("Areascan", "AreaScan"), "lines instead of frames would be sent"),
    Neutral(
        (
            "ExposureAuto",
            "GainAuto",
            "BlackLevelAuto",
            "BalanceWhiteAuto",
            "ContrastAuto",
            "SharpnessAuto",
            "SharpeningAuto",
            "SaturationAuto",
            "HueAuto",
            "pgrExposureCompensationAuto",
            "AcquisitionFrameRateAuto",
        ),
        OFF,
        "the camera would change its pictures by itself",
    ),
)
"""Modes that lock or overwrite other features; they come first."""

_PTP_SWITCHES = ("PtpEnable", "GevIEEE1588")
PTP = (*_PTP_SWITCHES, "PtpMode")
"""PTP under its names in SFNC 2, in GigE Vision, and in AVT_Manta_G507B."""
PTP_OFF = (Neutral(PTP, OFF, "the camera's clock might jump"),)
_NO_PTP = "the camera's clock would follow no PTP master"
PTP_ON = (Neutral(_PTP_SWITCHES, ON, _NO_PTP), Neutral(("PtpMode",), ("Auto", "Slave"), _NO_PTP))
PTP_LATCHES = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")
"""Commands after which the values below are those of now: Basler-a2A2600-20gmBAS; Basler-acA2440-20gm."""
PTP_STATES = ("PtpStatus", "GevIEEE1588Status")
PTP_OFFSETS = ("PtpOffsetFromMaster", "GevIEEE1588OffsetFromMaster", "GevIEEE1588OffsetFromMasterLatched")
"""The camera's clock minus that of its master, ns. The last one: FLIR-BFS-PGE-50S4C."""

GEOMETRY = (
    # Basler-acA2040-35gm; Basler-a2A2600-20gmBAS; PGR_BlackflyS_16S2C.
    Neutral(("ROIZoneMode",), OFF, "the picture would be cut into zones", per="ROIZoneSelector"),
    Neutral(
        ("BslMultipleROIRowsEnable", "MultiRoiEnable", "MultiRoiFeatureEnable"),
        OFF,
        "the picture would be cut into regions",
    ),
    # PGR_BlackflyS_16S2M has All, Sensor and ISP; Allied_Vision_1800_U-811m has Digital and Sensor.
    Neutral(
        ("BinningHorizontal", "BinningVertical"), 1, "pixels would be larger than calibrated", per="BinningSelector"
    ),
    Neutral(("DecimationHorizontal", "DecimationVertical"), 1, "pixels would be skipped", per="DecimationSelector"),
    Neutral(("Binning", "LegacyBinningVertical"), OFF, "pixels would be larger than calibrated"),
    # CenterX locks OffsetX: Basler-acA1300-30gm, Basler-a2A2600-20gmBAS.
    Neutral(("CenterX", "CenterY", "BslCenterX", "BslCenterY"), OFF, "the frame would begin elsewhere on the sensor"),
    # Before the pixel format: a mirrored Bayer filter has another order, and other formats are offered.
    Neutral(
        ("ReverseX", "ReverseY", "HorizontalFlip", "VerticalFlip"),
        OFF,
        "the picture would be mirrored, and its Bayer order another one",
    ),
    Neutral(("ImageCompressionMode", "CompressionMode"), OFF, "frames would be compressed"),
)
"""What decides which pixels of the sensor become a frame; before pixel format and region."""

_GAMMA_SWITCHES = ("GammaEnable", "GammaEnabled")
_SHARPENING_SWITCHES = ("SharpnessEnabled", "SharpnessEnable", "SharpeningEnable")
PICTURE = (
    # GammaEnable: Basler, Blackfly S; GammaEnabled: PGR_Flea3_GE_28S4C; Gamma alone: AVT_Mako_G234B and 42 more.
    Neutral(_GAMMA_SWITCHES, OFF, "grey levels would not be proportional to light"),
    Neutral(("Gamma",), 1.0, "grey levels would not be proportional to light", unless=_GAMMA_SWITCHES),
    # One switch for each table: AVT_GT2450CB.
    Neutral(("LUTEnable",), OFF, "grey levels would pass a look-up table", per="LUTSelector"),
    Neutral(("ContrastEnable",), OFF, "grey levels would not be proportional to light"),
    Neutral(("ContrastMode",), ("ContrastMode_Off", "Off"), "grey levels would not be proportional to light"),
    Neutral(("BslContrastMode",), ("Linear",), "grey levels would not be proportional to light"),
    Neutral(("BslBrightness", "BslContrast"), 0, "grey levels would be shifted or stretched"),
    Neutral(("DigitalShift",), 0, "grey levels would be multiplied"),
    Neutral(_SHARPENING_SWITCHES, OFF, "edges would be moved and overshoot"),
    Neutral(("SharpnessEnhancementAbs", "BslSharpnessEnhancement"), LEAST, "edges would be moved and overshoot"),
    # Allied_Vision_1800_U-811m: 0 is none, negative values blur.
    Neutral(("Sharpness",), 0, "edges would be moved and overshoot", unless=_SHARPENING_SWITCHES),
    Neutral(
        ("DenoisingEnable", "NoiseReductionEnable", "NoiseReduction", "PgiMode"),
        OFF,
        "fine structures would be smoothed",
    ),
    Neutral(("NoiseReductionAbs", "BslNoiseReduction"), LEAST, "fine structures would be smoothed"),
    Neutral(
        ("ColorTransformationEnable", "ColorAdjustmentEnable", "SaturationEnable", "SaturationEnabled", "HueEnabled"),
        OFF,
        "colours would be mixed",
    ),
    Neutral(("ProcessedRawEnable",), OFF, "raw pixels would be processed in the camera"),
    # 1 is unity in all descriptions with a ratio as a number; Basler-acA1300-30gm counts 64 raw steps for it.
    Neutral(
        ("BalanceRatio", "BalanceRatioAbs"),
        1.0,
        "colours would be weighted, and grey levels clipped unequally",
        per="BalanceRatioSelector",
    ),
    # Defective pixels are the maker's own measurement of this sensor: their correction stays on.
    Neutral(
        (
            "DefectCorrectStaticEnable",
            "pgrDefectPixelCorrectionEnable",
            "DefectPixelCorrectionEnable",
            "DefectMaskEnable",
            "DefectMaskPixelEnable",
            "DefectMaskColumnEnable",
        ),
        ON,
        "defective pixels would look like defects of the board",
    ),
    Neutral(("BslStaticDefectPixelCorrectionMode",), ("Factory",), "defective pixels would look like defects"),
    # One pattern for each generator: FLIR_ORX_10G_245S8M. Normal is none: FLIR_SC6700.
    Neutral(("TestPattern",), ("Off", "Normal"), "a test picture would be sent", per="TestPatternGeneratorSelector"),
    Neutral(("TestImageSelector",), ("Off",), "a test picture would be sent"),
    Neutral(("InfoFieldFrameCounterEnable",), OFF, "counters would replace pixels"),
    Neutral(
        ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled", "AcquisitionFrameRateMode"),
        OFF,
        "pulses that come faster than this rate would be ignored",
    ),
)
"""What decides how light becomes a grey level, and how often."""

ON_THE_LINE = (
    Neutral(("LineMode",), ("Input",), "the trigger would meet an output", per="LineSelector"),
    Neutral(("LineInverter",), OFF, "frames would begin at the end of the pulse", per="LineSelector"),
)
"""The trigger's input."""

TRIGGER_CONTROL = (
    # Basler-scA1400-30gm, -scA1300-32gm, -scA640-70gm: with Legacy, there is no FrameStart.
    Neutral(("TriggerControlImplementation",), ("Standard",), "pulses would start acquisitions instead of frames"),
)
"""What decides which triggers there are."""
TRIGGERS = (Neutral(("TriggerMode",), OFF, "it would delay or multiply frames", per="TriggerSelector"),)
"""All triggers; that of a frame is switched on at last. One that is on locks others, and at some makes ExposureMode."""
_DELAY_SWITCHES = ("TriggerDelayEnabled", "TriggerDelayEnable")
ON_THE_TRIGGER = (
    Neutral(_DELAY_SWITCHES, OFF, "frames would be exposed after their pulse", per="TriggerSelector"),
    # The lowest one, as Blackfly S cannot go below some µs.
    Neutral(
        ("TriggerDelay", "TriggerDelayAbs"),
        LEAST,
        "frames would be exposed after their pulse",
        per="TriggerSelector",
        unless=_DELAY_SWITCHES,
    ),
    Neutral(
        ("TriggerDivider", "TriggerMultiplier"), 1, "pulses and frames would not be one to one", per="TriggerSelector"
    ),
    Neutral(
        ("TriggerOverlap",),
        # Off ignores a pulse while the last frame is read out. Lucid has PreviousFrame only.
        ("ReadOut", "PreviousFrame"),
        "pulses would be ignored while a frame is read out",
        per="TriggerSelector",
    ),
)
"""The trigger of a frame."""

SHUTTERS = ("ShutterMode", "SensorShutterMode", "SensorShutterType")
GLOBAL_SHUTTERS = ("Global", "GlobalShutter")
"""Entries of the shutter's feature with which all lines of a frame are exposed at once. GlobalReset ends them one by
one.
"""
EXPOSURES = ("ExposureTime", "ExposureTimeAbs")
"""Names of the exposure in a unit of time, in order of preference."""
RAW_EXPOSURE = "ExposureTimeRaw"
"""The exposure of Imperx, whose text alone states its unit: "in units of uSeconds"."""
MICROSECONDS = r"(?i)(\b(in|of)\s+|[\[(])(u|µ|μ|micro[- ]?)s(ec|\b)"
"""How texts of descriptions write the unit: in µs, (usec), [us]; "contact us" is none."""
TIME_UNITS_US = {"": 1.0, "us": 1.0, "µs": 1.0, "μs": 1.0, "ns": 1e-3, "ms": 1e3, "s": 1e6}
"""Unit of an exposure → µs. Orca_Fire_C16240-20UP states s; AVT_Mako_G234B states none and counts µs."""
CLOCKS = (
    # SFNC 2: Blackfly S, ace 2, Alvium. The value is in ns.
    ("TimestampLatch", "TimestampLatchValue"),
    # PGR_BFS_U3_51S5M, PGR_GS3_U3_51S5M, FLIR_FL3_U3_13S2C: the latched value has the name of SFNC's older draft.
    ("TimestampLatch", "Timestamp"),
    # GigE Vision 1, in ticks: Basler ace and scout, AVT, Blackfly, Flea3 GE.
    ("GevTimestampControlLatch", "GevTimestampValue"),
)
"""Commands that latch the time, and the features that then have it."""


def plain(name: str) -> str:
    """Return the name of a maker or model in lower case without spaces, dots and underlines."""
    return re.sub(r"[^a-z0-9]", "", name.casefold())


@dataclass(frozen=True)
class Make:
    """What the cameras of one make need, and their descriptions do not say."""

    line: str = ""
    """The opto-isolated input; empty: the first line that the trigger offers."""
    sequencer_path: int = 0
    """The path of a sequencer that leads from set to set."""
    gain_in_db: bool = False
    """Whether a gain without a unit is in dB."""


_FLIR = Make("Line0")
_ALLIED_VISION = Make(gain_in_db=True)
MAKES = {
    # Line0: opto-isolated input of Blackfly S, Grasshopper3, Oryx ("Input/Output Control" of their references).
    "flir": _FLIR,
    "pointgrey": _FLIR,
    "teledyne": _FLIR,
    # Line1: opto-isolated input of ace and ace 2 (ace GigE AW00089317, section 5.7). Path 0 of the sequencers only
    # leads back to set 0 (ace U, "Sequencer").
    "basler": Make("Line1", sequencer_path=1),
    "lucid": Make("Line2"),
    # "Units are usually in dB": AVT_Mako_G234B, AVT_GC1380H. Mako, Manta, GT and GC have no Line0; Alvium has it.
    "alliedvision": _ALLIED_VISION,
    "prosilica": _ALLIED_VISION,
}
"""What is particular to each make, by the beginning of its vendor's plain name; the longest one counts."""
GENERIC = Make()
"""An unknown make."""


def make_of(vendor: str) -> Make:
    """Return what is particular to a vendor's cameras; nothing if the vendor is not known."""
    name = plain(vendor)
    start = max((start for start in MAKES if name.startswith(start)), key=len, default="")
    return MAKES.get(start, GENERIC)


def usual_line(vendor: str, sources: Sequence[str]) -> str:
    """Return the input that triggers a camera: that of its make, else the first line among its trigger sources."""
    lines = sorted(source for source in sources if re.fullmatch(r"Line\d+", source))
    # PCO1600: ExtTrig; its ExtTrigAndAcqEnbl needs a second wire.
    lines = lines or [source for source in sources if re.match(r"Line|Ext", source)]
    usual = make_of(vendor).line
    return usual if usual in lines or not lines else lines[0]


@dataclass(frozen=True)
class RawGain:
    """How dB above the lowest gain are counted by a camera without a gain in dB, given its lowest count."""

    db: Callable[[float, float], float]
    """(count, lowest count) → dB."""
    count: Callable[[float, float], float]
    """(dB, lowest count) → count."""


def _scout_db(count: float) -> float:
    return 20 * math.log10((658 + count) / (658 - count)) if count < 512 else 0.0354 * count


def _scout_count(db: float) -> float:
    if db >= _scout_db(512):
        return db / 0.0354
    ratio = 10 ** (db / 20)
    return 658 * (ratio - 1) / (ratio + 1)


_IN_DB = RawGain(lambda count, _low: count, lambda db, _low: db)
_0_0359_DB = RawGain(lambda count, low: 0.0359 * (count - low), lambda db, low: low + db / 0.0359)
_LINEAR = RawGain(lambda count, low: 20 * math.log10(count / low), lambda db, low: low * 10 ** (db / 20))
_SCOUT = RawGain(
    lambda count, low: _scout_db(count) - _scout_db(low), lambda db, low: _scout_count(db + _scout_db(low))
)
RAW_GAINS = (
    # pilot: manual, "Gain". CCD models of ace: the same step (acA1300-30um, 550 counts: 19.745 dB, AW00123402 table
    # 30); their counts are in AW00089316 table 17. Their USB twins count 0 dB from the lowest setting, as is done here.
    (r"piA|acA(640-90|640-100|640-120|645-100|750-30|780-75|1300-22|1300-30|1600-20)", _0_0359_DB),
    # 20 · log10(GainRaw / 32), from 36 on: AW00089317, "acA2000-50, acA2040-25 only".
    (r"acA(2000-50|2040-25)", _LINEAR),
    # 20 · log10(GainRaw / 136), from 136 on: device ACA800 of MDSplus, which quotes Basler's page "Gain".
    (r"acA800-200", _LINEAR),
    # scout: two branches that meet at 512 (scout light manual, "Gain").
    (r"scA|slA", _SCOUT),
)
"""Basler's cameras without a gain in dB: model → formula."""


def raw_gain(vendor: str, model: str) -> RawGain | None:
    """Return how a camera counts its gain; None if no document of its maker is known."""
    if make_of(vendor).gain_in_db:
        return _IN_DB
    if not plain(vendor).startswith("basler"):
        return None
    return next((formula for models, formula in RAW_GAINS if re.match(models, model)), None)


LINK_SPEEDS = (("DeviceLinkSpeed", "Bps"), ("GevLinkSpeed", "Mbps"))
"""Features that state the speed of a camera's link, and their unit where the description states none: SFNC 2; GigE
Vision (Basler-acA1300-60gm: "in Mbps"). ViewWorks_VNP604 states MBps."""
LINK_LIMITS = ("DeviceLinkThroughputLimit", "StreamBytesPerSecond")
"""Features that limit what a camera sends, in bytes per second unless they state another unit: SFNC 2; AVT_GC1380H and
other cameras of Allied Vision without GevSCPD."""
_MISNUMBERING = ("blackflybfly", "flea3fl3", "bfly", "fl3")


def misnumbers_resends(vendor: str, model: str) -> bool:
    """Return whether a camera may send packets under wrong numbers while it sends others again.

    Reported of a Blackfly (BFLY) of Point Grey (Aravis #311); the GigE cameras of that generation share its firmware.
    """
    return plain(vendor).startswith("pointgrey") or plain(model).startswith(_MISNUMBERING)
