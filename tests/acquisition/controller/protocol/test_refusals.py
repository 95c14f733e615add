"""Foreign devices and other versions are refused, and refusals have readable texts."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.controller.protocol import Nak, Reason, Type, check_ident, check_interlock, describe
from vaoi_station.errors import DeviceError


def test_our_own_controller_is_accepted() -> None:
    assert check_ident(IDENT.pack()) == IDENT
    assert check_ident(replace(IDENT, minor=9).pack() + b"further fields").minor == 9


def test_another_major_version_is_refused_with_the_remedy() -> None:
    with pytest.raises(DeviceError, match=r"speaks protocol 2\.0, this station 1\.3") as caught:
        check_ident(b"\2\0 and whatever that version says")
    assert caught.value.code == "protocol-version"
    assert "flash" in caught.value.action


def test_a_foreign_device_is_named() -> None:
    with pytest.raises(DeviceError, match="calls itself b'printer'"):
        check_ident(replace(IDENT, board=b"printer\0").pack())


def test_old_firmware_is_refused_with_the_remedy() -> None:
    with pytest.raises(DeviceError, match=r"has firmware 0\.9\.3 with protocol 1\.3, but needs 1\.1\.0") as caught:
        check_ident(replace(IDENT, firmware_major=0, firmware_minor=9, firmware_patch=3).pack())
    assert caught.value.code == "firmware-too-old"
    assert "flash" in caught.value.action


def test_firmware_1_1_is_used_without_an_interlock() -> None:
    old = check_ident(replace(IDENT, minor=1, firmware_minor=1).pack()[:48])
    assert old.ready_longest_ms == 0
    with pytest.raises(DeviceError, match=r"firmware 1\.1\.3, which has no output 'line ready'") as caught:
        check_interlock(old)
    assert caught.value.code == "interlock-missing"
    assert "flash" in caught.value.action
    check_interlock(check_ident(IDENT.pack()))


@pytest.mark.parametrize(
    ("nak", "words"),
    [
        (Nak(Type.COMMIT, Reason.RANGE, 4, 10000), "COMMIT was refused: period is out of range, .* 10000"),
        (Nak(Type.COMMIT, Reason.LED_LIMIT, 17, 2000), "step 1 asks more of the LEDs than their limit of 2000 ticks"),
        (Nak(Type.ARM, Reason.STATE, 0, 3), "ARM was refused: the controller is SAFE"),
        (Nak(Type.ARM, Reason.CHECKSUM, 0, 0xABC), "0x00000abc"),
        (Nak(Type.FIRE_ONE, Reason.LED_BUDGET, 2, 0), "channel 2 have not cooled down"),
        (Nak(0x3F, Reason.UNKNOWN, 0, 0), "request 0x3f was refused: this firmware does not know it"),
        (Nak(Type.CLOCK, 99, 0, 0), "CLOCK was refused: 99"),
    ],
)
def test_refusals_are_sentences(nak: Nak, words: str) -> None:
    assert re.search(words, describe(nak))
