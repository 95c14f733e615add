"""Names of the mosaics of a run, as they stand in addresses: `board`, `board,light=left`, `board,hdr` …

Exposures have up to six decimals. Commas, slashes and control characters of a light's name are written as ~ and two
hexadecimal digits, and ~ itself: some programs decode the per cent signs of an address twice.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from vaoi_station.errors import NotFoundError

_FIRST = "board"
_NUMBER = re.compile(r"\d{1,9}(\.\d{1,6})?")
_RESERVED = re.compile(r"[~,/\x00-\x1f\x7f]")
_WRITTEN = re.compile(r"~([0-9A-F]{2})")


class PictureName(NamedTuple):
    """Which frames a mosaic is made of."""

    light: str | None = None
    exposure_us: float | None = None
    hdr: bool = False

    def __str__(self) -> str:
        parts = [_FIRST]
        if self.light is not None:
            parts.append(f"light={_RESERVED.sub(lambda match: f'~{ord(match[0]):02X}', self.light)}")
        if self.exposure_us is not None:
            parts.append(f"exposure={self.exposure_us:.6f}".rstrip("0").rstrip("."))
        if self.hdr:
            parts.append("hdr")
        return ",".join(parts)


def parse_name(text: str) -> PictureName:
    """Parse the name of a mosaic.

    Raises:
        NotFoundError: it is no such name.
    """
    first, *options = text.split(",")
    light: str | None = None
    exposure_us: float | None = None
    hdr = False
    for option in options:
        key, _, value = option.partition("=")
        if key == "light" and value and light is None:
            light = _WRITTEN.sub(lambda match: chr(int(match[1], 16)), value)
        elif key == "exposure" and exposure_us is None and _NUMBER.fullmatch(value):
            exposure_us = float(value)
        elif option == "hdr" and not hdr:
            hdr = True
        else:
            first = ""
    if first != _FIRST:
        raise NotFoundError(
            f"there is no mosaic {text!r:.80}; names are 'board', with ',light=NAME', ',exposure=µs' or ',hdr' added.",
            action="Take a name from the run's list of mosaics.",
            code="no-such-mosaic",
        )
    return PictureName(light, exposure_us, hdr)
