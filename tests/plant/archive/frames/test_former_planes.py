"""Planes of versions 1 and 2 can be read."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest

from vaoi_station.plant.archive.frames import decode_frame
from vaoi_station.plant.archive.frames.former_planes import decode_former_plane

STORED = {
    (1, 1): (
        "c-n1Hze_?<6#n!+Q&TJGK@CAvL_`!9LmC=-gSF_8MbwZ`(NK#`Mng43I7kuw2N4wL)S84tg|!Ga6a<l!Qw>oF(huu&A8Ok3efJ*D"
        "&-<NokD=La1yC!*3=6EV!GRN;VlPdU8wKXRiDn*%dPYpx&J*?8fkiWLPeh%MM7KXgha$cu1LESw1WbJpwJ;!Q1a^gNW(^35nitWk"
        "&H$`gfQ2lu{z_zP0Hz(lmEda(1F3f+w}?4K53k^xRldk2_>Sv=^BN#1V$n#RgaRu{5k^#?9a=C3&bVsv|B3#xX(;7*6=4-535o)7"
        "xH<*X@-jV>sm+*{$yqszHY=#P?yLo<6YxSEFTdrLj&@PJ<Qa7~XVNvxXp{baw6h<RuMa{?;ZLDrvTJo*PA8J?)W)DMqa==2a+wRM"
        "Yq>k>2}Yjc9>3e?4?mBc4Gd2VHTB(H##_CC?Av_DWI*ly3!uz!Hv"
    ),
    (1, 2): (
        "c-mu<;Nf9lVBi8`76uLmP6i%^eGCT}4lx`OVql2lWMFvz{{R0VRtAPE><kQ({{R243B(ORz7~)l%+AOl`|tmMZA%7*S<DO!`g{KW"
        "7vp7Mm<|-P0-6}l$iQIt`~UwhKbRRZfwa8<14Atf1H%)b89__`|Cjp+WB|>o<zry@3$*KkHzPv}P>%pmT_n(qg+OVaRu+ccfB*kK"
        "z|X+Y!^FS<GFNopzyD0e%*+Z5L;+?L3c&=DOd#4AU4sC2a~O%SOo53B!eBy(F+q4txbz@NC@2u&5C~94Fb#~cc-a8AWl#%Yb|Krz"
        "3Z=ss7}yX32#17#!!8&^WQS-t1uhJKvG5<alj91my-xh56$T3f7TPo2uohXk;)3><fQMJ^E|%80oe>Vwb^k>`%Oa=s7o20oq@7k?"
        "kY}9Ztl<>;LUh+wg(+Nr1sgsmZJ6`LJA@GcL2YcZ"
    ),
    (2, 1): (
        "c-muR;bLH50AV&D$-}_Qz{kMPaFF5Q@BjZF0fpOH7#P0%`~N=+NQW{qFgRr}Fg*MZ0Wv^c>_E&4#6N-jxF7%jGY|lR*oB!H7z_|R2-6U"
        "YI-raKLMdE}5r!%_gBeZSh#AFJAaG$eK+?mEWCFTg1uV{n03}p$2NZ?^ib=>0U|=>tb2PHk8I%zUS+Oz^K#>LRp8iF<M6NDv%kTOHq;`"
        "pz)&z?%?qijFdC7hK&ir>rzQw9bximH|<X11#T;*N5^5s77SeL-qu2(^a&0X(KjEh(0d9_DCYJ&9j-AN%64=rH;0Elr$Jp"
    ),
    (2, 2): (
        "c-muP;bLH5fM6a5UWUC42N{kqoM8Cz_y7OHK;gTL3=GBp{{LUf%D~_RWLG9IFns#||365F5D@<XvO#<fAbac6|Nj|~0W$-Gf&mf_$Yy3"
        "{zyS<E2wBz;Rh|ih$AnAL0f<?cVYV`(*kOe3LZ~=80LmycVW>1VV8Esy%~T{AH2(s%E1?LmKpo8DfNUIu!EB7s%m$@_!Ox1&EdXb+f|U"
        "k=i2E8szgD#6Pid*!7$~%hsn4B3E^JvwjLW0^J70G0WVpA?z+!s#=OTu55zg9>!|5ST|J^5Ea5t@4tn$S;uf^%cnk6%K7cOMEsk7;iNc"
        "&ng1^{PYN6i"
    ),
}
"""Planes as former releases have stored them, by version and distance of neighbours; zlib, base 85."""


def stored_plane(version: int, step: int) -> tuple[bytes, np.ndarray]:
    """Return what was stored, and the plane."""
    y, x = np.mgrid[:9, :11]
    plane = ((x * 37 + y * y * 11) % 97 + (x > 7) * 3000).astype(np.uint16)
    return zlib.decompress(base64.b85decode(STORED[version, step])), plane


@pytest.mark.parametrize(("version", "step"), STORED)
def test_planes_of_former_releases_can_be_read(version: int, step: int) -> None:
    stored, plane = stored_plane(version, step)
    assert np.array_equal(decode_former_plane(stored, plane.shape, version), plane)


@pytest.mark.parametrize("version", [1, 2])
def test_a_frame_of_a_former_version_can_be_read(version: int) -> None:
    stored, plane = stored_plane(version, 1)
    head = b"".join(n.to_bytes(4, "little") for n in (9, 11, zlib.crc32(plane.tobytes()), 0, len(stored)))
    assert np.array_equal(decode_frame(b"VFR%d\2\1" % version + head + stored), plane)


@pytest.mark.parametrize("version", [1, 2])
def test_damage_of_former_planes_is_named(version: int) -> None:
    stored, plane = stored_plane(version, 1)
    with pytest.raises(ValueError, match="head of a plane is invalid"):
        decode_former_plane(b"\3" + stored[1:], plane.shape, version)
    with pytest.raises(ValueError, match="end too early"):
        decode_former_plane(stored, (90, 11), version)
