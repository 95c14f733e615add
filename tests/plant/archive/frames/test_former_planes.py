"""Planes of version 1 can be read."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest

from vaoi_station.plant.archive.frames import decode_frame
from vaoi_station.plant.archive.frames.former_planes import decode_former_plane

STORED = {
    1: (
        "c-n1Hze_?<6#n!+Q&TJGK@CAvL_`!9LmC=-gSF_8MbwZ`(NK#`Mng43I7kuw2N4wL)S84tg|!Ga6a<l!Qw>oF(huu&A8Ok3efJ*D"
        "&-<NokD=La1yC!*3=6EV!GRN;VlPdU8wKXRiDn*%dPYpx&J*?8fkiWLPeh%MM7KXgha$cu1LESw1WbJpwJ;!Q1a^gNW(^35nitWk"
        "&H$`gfQ2lu{z_zP0Hz(lmEda(1F3f+w}?4K53k^xRldk2_>Sv=^BN#1V$n#RgaRu{5k^#?9a=C3&bVsv|B3#xX(;7*6=4-535o)7"
        "xH<*X@-jV>sm+*{$yqszHY=#P?yLo<6YxSEFTdrLj&@PJ<Qa7~XVNvxXp{baw6h<RuMa{?;ZLDrvTJo*PA8J?)W)DMqa==2a+wRM"
        "Yq>k>2}Yjc9>3e?4?mBc4Gd2VHTB(H##_CC?Av_DWI*ly3!uz!Hv"
    ),
    2: (
        "c-mu<;Nf9lVBi8`76uLmP6i%^eGCT}4lx`OVql2lWMFvz{{R0VRtAPE><kQ({{R243B(ORz7~)l%+AOl`|tmMZA%7*S<DO!`g{KW"
        "7vp7Mm<|-P0-6}l$iQIt`~UwhKbRRZfwa8<14Atf1H%)b89__`|Cjp+WB|>o<zry@3$*KkHzPv}P>%pmT_n(qg+OVaRu+ccfB*kK"
        "z|X+Y!^FS<GFNopzyD0e%*+Z5L;+?L3c&=DOd#4AU4sC2a~O%SOo53B!eBy(F+q4txbz@NC@2u&5C~94Fb#~cc-a8AWl#%Yb|Krz"
        "3Z=ss7}yX32#17#!!8&^WQS-t1uhJKvG5<alj91my-xh56$T3f7TPo2uohXk;)3><fQMJ^E|%80oe>Vwb^k>`%Oa=s7o20oq@7k?"
        "kY}9Ztl<>;LUh+wg(+Nr1sgsmZJ6`LJA@GcL2YcZ"
    ),
}
"""Planes as the first release has stored them, by the distance of neighbours; zlib, base 85."""


def stored_plane(step: int) -> tuple[bytes, np.ndarray]:
    """Return what was stored, and the plane."""
    y, x = np.mgrid[:9, :11]
    plane = ((x * 37 + y * y * 11) % 97 + (x > 7) * 3000).astype(np.uint16)
    return zlib.decompress(base64.b85decode(STORED[step])), plane


@pytest.mark.parametrize("step", [1, 2])
def test_planes_of_former_releases_can_be_read(step: int) -> None:
    stored, plane = stored_plane(step)
    assert np.array_equal(decode_former_plane(stored, plane.shape), plane)


def test_a_frame_of_the_former_version_can_be_read() -> None:
    stored, plane = stored_plane(1)
    head = b"".join(n.to_bytes(4, "little") for n in (9, 11, zlib.crc32(plane.tobytes()), 0, len(stored)))
    assert np.array_equal(decode_frame(b"VFR1\2\1" + head + stored), plane)


def test_damage_of_former_planes_is_named() -> None:
    stored, plane = stored_plane(1)
    with pytest.raises(ValueError, match="head of a plane is invalid"):
        decode_former_plane(b"\3" + stored[1:], plane.shape)
    with pytest.raises(ValueError, match="end too early"):
        decode_former_plane(stored, (90, 11))
