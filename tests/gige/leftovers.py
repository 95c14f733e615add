"""What an earlier program may have left in a camera, and what of it a station has not put right."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from tests.gige.referee import Referee
from vaoi_station.rig.gige.camera import Camera
from vaoi_station.rig.gige.formula import Number

LEAST = "its smallest value"


class _Kind(NamedTuple):
    names: tuple[str, ...]
    neutral: object
    """The value that changes neither pictures nor times."""
    left: Number | str
    """The value that is left over; an enumeration of which it is no entry takes any other entry."""
    switch: tuple[str, ...] = ()
    """Switches that make it harmless when they are off."""


KINDS = (
    _Kind(("TriggerDelayEnabled", "TriggerDelayEnable"), False, 1),
    _Kind(("TriggerDelay", "TriggerDelayAbs"), LEAST, 500, ("TriggerDelayEnabled", "TriggerDelayEnable")),
    _Kind(("LUTEnable", "GammaEnable", "GammaEnabled"), False, 1),
    _Kind(("Gamma",), 1.0, 2.0, ("GammaEnable", "GammaEnabled")),
    _Kind(("SharpnessEnabled", "SharpnessEnable", "SharpeningEnable"), False, 1),
    _Kind(("DenoisingEnable", "NoiseReductionEnable", "SaturationEnable"), False, 1),
    _Kind(("DefectCorrectStaticEnable", "pgrDefectPixelCorrectionEnable", "DefectMaskEnable"), True, 0),
    _Kind(("ReverseX", "ReverseY", "LineInverter"), False, 1),
    _Kind(("BalanceRatio", "BalanceRatioAbs"), 1.0, 2.0),
    _Kind(("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical"), 1, 2),
    _Kind(("AcquisitionBurstFrameCount", "TriggerDivider", "TriggerMultiplier"), 1, 2),
    _Kind(("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled"), False, 1),
    _Kind(("TestPattern", "TestImageSelector", "PtpMode"), "Off", ""),
    _Kind(("SequencerMode", "SequencerConfigurationMode"), "Off", "On"),
    _Kind(("SequenceEnable", "PtpEnable", "GevIEEE1588", "pgrHDRModeEnabled"), False, 1),
    _Kind(("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto", "SharpnessAuto", "HueAuto"), "Off", ""),
    _Kind(("SaturationAuto", "AcquisitionFrameRateAuto", "pgrExposureCompensationAuto"), "Off", ""),
    _Kind(("TriggerMode",), "Off", "On"),
    _Kind(("ExposureMode",), "Timed", "TriggerWidth"),
)


class Leftover(NamedTuple):
    """A value that was left in a camera."""

    name: str
    at: dict[str, Number | str]
    """Where its selectors stand."""
    value: Number | str
    kind: _Kind

    def __str__(self) -> str:
        where = "".join(f"[{entry}]" for entry in self.at.values())
        return f"{self.name}{where} = {self.value}"


def leave_all(camera: Camera) -> list[Leftover]:
    """Leave something in every feature that the camera has, for every setting of its selectors."""
    left = []
    for kind in KINDS:
        for name in kind.names:
            for at in camera.selections(name):
                value = _value(camera, kind, name, at)
                if value is not None:
                    camera.put(name, value, **at)
                    if camera.value(name, **at) == value or camera.kind(name) == "Boolean":
                        left.append(Leftover(name, at, value, kind))
    return left


def survivors(camera: Camera, left: list[Leftover]) -> Iterator[str]:
    """Yield what is still there, as the reference reads it in the camera's units."""
    in_use = {"TriggerSelector": camera.frame_trigger, "LineSelector": camera.trigger()}
    if camera.offers("TriggerControlImplementation"):  # Basler-scA1400-30gm has two ways to be triggered
        in_use["TriggerControlImplementation"] = str(camera.value("TriggerControlImplementation"))
    referee = Referee(camera)
    for leftover in left:
        name, kind = leftover.name, leftover.kind
        idle = any(entry != in_use.get(selector, entry) for selector, entry in leftover.at.items())
        # The trigger that is in use must be on, and all others off; their other features do not matter then.
        other_way = leftover.at.get("TriggerControlImplementation") != in_use.get("TriggerControlImplementation")
        if other_way or idle != (name == "TriggerMode") or (name == "TriggerMode" and not _has_several(camera, name)):
            continue
        if not all(referee.writable(selector) for selector in leftover.at):
            continue
        referee.select(leftover.at)
        if any(referee.has(switch) and not referee.value(switch) for switch in kind.switch) or not referee.has(name):
            continue
        got = referee.value(name)
        wanted = referee.node(name).min if kind.neutral is LEAST else kind.neutral
        same = abs(got - wanted) < 1e-3 if isinstance(wanted, int | float) else got == wanted
        if not same:
            yield f"{leftover} reads {got!r}, not {wanted!r}"


def _value(camera: Camera, kind: _Kind, name: str, at: dict[str, Number | str]) -> Number | str | None:
    """Return what can be left over in a feature now; None if there is nothing."""
    if any(camera.kind(s) == "Enumeration" and entry not in camera.entries(s) for s, entry in at.items()):
        return None
    with camera.selecting(at):
        if not camera.offers(name) or not _is_register(camera, name):
            return None
        if camera.kind(name) == "Enumeration":
            entries = [e for e in camera.entries(name) if e != kind.neutral]
            return kind.left if kind.left in entries else entries[0] if entries and kind.left == "" else None
        if camera.kind(name) == "Boolean":
            return kind.left
        low, high = camera.limits(name)
        return kind.left if low <= float(kind.left) <= high else None


def _is_register(camera: Camera, name: str) -> bool:
    """Whether a client can write a feature into a register of the camera."""
    register = camera.features.register_of(name)
    return register is not None and camera.features.description.text_of(register, "AccessMode") == "RW"


def _has_several(camera: Camera, name: str) -> bool:
    """Whether a feature has a value of its own for each setting of its selectors, which not all makers have."""
    features, places = camera.features, set()
    for k, at in enumerate(features.selections(name)):
        with features.selecting(at):
            register = features.register_of(name)
            if register is not None:
                places.add((features.address(register), k if register in features.banked else 0))
    return len(places) > 1
