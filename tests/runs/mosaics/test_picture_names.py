"""Names of mosaics in addresses."""

from __future__ import annotations

import pytest

from vaoi_station.errors import NotFoundError
from vaoi_station.runs.mosaics.picture_names import PictureName, parse_name


@pytest.mark.parametrize(
    "name",
    [
        PictureName(),
        PictureName("left"),
        PictureName(None, 15.5),
        PictureName("a b=c", 250.0),
        PictureName("x", hdr=True),
        PictureName(None, 333.3333),
        PictureName(None, 1234.5678),
        PictureName(None, 2_000_000.0),
        PictureName("a,b/c", 12345.67),
        PictureName("x=hdr,y"),
        PictureName("50%2C~2C\n"),
    ],
)
def test_names_are_read_as_they_are_written(name: PictureName) -> None:
    assert parse_name(str(name)) == name
    assert not set(str(name)) & set("/\n"), "an address has them elsewhere, or cannot have them"


@pytest.mark.parametrize("text", ["", "bard", "board,light=", "board,hdr,hdr", "board,exposure=-1", "board,exposure=x"])
def test_other_names_are_refused(text: str) -> None:
    with pytest.raises(NotFoundError, match="there is no mosaic"):
        parse_name(text)
