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
    ],
)
def test_names_are_read_as_they_are_written(name: PictureName) -> None:
    assert parse_name(str(name)) == name


@pytest.mark.parametrize("text", ["", "bard", "board,light=", "board,hdr,hdr", "board,exposure=-1", "board,exposure=x"])
def test_other_names_are_refused(text: str) -> None:
    with pytest.raises(NotFoundError, match="there is no mosaic"):
        parse_name(text)
