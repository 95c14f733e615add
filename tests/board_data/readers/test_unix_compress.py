from __future__ import annotations

import base64

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.readers.unix_compress import decompress
from vaoi_station.errors import InputError

TEXT = "UNITS=MM\n" + "".join(f"CMP 0 {n} {n * n % 97} 0 N R{n} x ;\n" for n in range(40))
WRITTEN = base64.b85decode(
    "ADxO-oFt(#rALz{3WhX+0s=<EhYp>9km3*zh#d(RK8yi^W5kIZEn-y2(4h<vG#*Nna#Cc*k|1V)$f0tgOqV1dri@{urj(R8H9D*TLI%-~QiukH*>gruq&="
    "5Dyn&J?QmRrN;s9YICDN@~XM(`t5yVQGVPiOyiBv6!v>au4H48H2#g`jT(xBS5<=vbPW5~R5vhB^kLOZ4`Ojk+_pon3{AUdP$%E@mdZ|rG<@#UzR15?d$v"
    "~diqp*wD!!PYd`)G=t@aM%`YY8in&PsE*hWMUZ{YqVYoyf<ExCv!Y)EW@vFm@;J2m`nWd^M`V0THX!$x=ErmhVNE-yJrsSyFq&|O0@=U=BU@p*t!+zeB*$"
    "N(zH>Uxb5{bn8a6O0pgcfWn<Mxpj`l-R0Dca%;4N{G0D`NPplaT(+nx$U=@MgQ8)upHf$Fmc>p%mpH1qCNL36b&Jdr7^ewm246gyWpN%&CrvL"
)
"""The text as ncompress 4.2.4.6 writes it with codes of at most 10 bits."""


def compressed(data: bytes, widest: int = 16, clear_every: int = 10**9) -> bytes:
    """Write LZW as compress does, but empty the table after `clear_every` codes."""
    bits, at, group, width, known = 0, 0, 0, 9, 257
    table = {bytes([n]): n for n in range(256)}

    def put(code: int, *, entry: bool) -> None:
        nonlocal bits, at, group, width, known
        bits, at = bits | code << at, at + width
        known = 256 if code == 256 else min(known + entry, 1 << widest)
        if code == 256 or (known > (1 << width) - 1 and width < widest):
            at = group = group + -(-(at - group) // (8 * width)) * 8 * width
            width = 9 if code == 256 else width + 1

    count, word = 0, b""
    for byte in data:
        longer = word + bytes([byte])
        if longer in table:
            word = longer
            continue
        put(table[word], entry=count > 0)
        count += 1
        if len(table) + 1 < 1 << widest:
            table[longer] = len(table) + 1
        if count % clear_every == 0:
            put(256, entry=False)
            table = {bytes([n]): n for n in range(256)}
        word = bytes([byte])
    if word:
        put(table[word], entry=count > 0)
    return b"\x1f\x9d" + bytes([0x80 | widest]) + bits.to_bytes((at + 7) // 8, "little")


@given(st.binary(max_size=400) | st.text("ab", max_size=2000).map(str.encode), st.integers(10, 16), st.integers(1, 300))
def test_what_was_compressed_comes_back(data: bytes, widest: int, clear_every: int) -> None:
    assert decompress(compressed(data, widest, clear_every), "f", 10**6) == data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x1f\x9d", "its codes have 0 bits, but must have 10 to 16"),
        (b"\x1f\x9d\x9fabc", "its codes have 31 bits"),
        (WRITTEN[:3] + b"\xff\xff" + WRITTEN[5:], "names entry"),
        (WRITTEN[:4], "ends within a code"),
    ],
)
def test_damaged_files_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=rf"f: is no valid file of compress \(\.Z\): .*{message}"):
        decompress(data, "f", 10**6)


def test_a_file_that_becomes_too_long_is_refused() -> None:
    with pytest.raises(InputError, match="is longer than 1000 bytes"):
        decompress(compressed(b"a" * 100_000), "f", 1000)
