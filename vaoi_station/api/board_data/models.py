"""Schemas of the requests and replies about imports of board data."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from vaoi_station.api.rest_models import PREVIEW_ID, PlainText
from vaoi_station.board_data.overview import ImportOverview
from vaoi_station.model import Strict

FormatName = Literal["kicad", "gencad", "ipc2581", "odb", "eagle", "html-bom", "centroid"]


class ImportOptions(Strict):
    """What a person says about an uploaded file; what is absent is recognised."""

    side: Literal["top", "bottom"] = Field(default="top", description="The side that is up in the line.")
    name: str | None = Field(default=None, max_length=200, description="Name of the board type; else the design's.")
    format: FormatName | None = None
    units: Literal["mm", "inch", "mil"] | None = Field(default=None, description="Of a centroid file.")
    columns: str | None = Field(
        default=None,
        max_length=500,
        description="Of a centroid file, as `ref=1,x=3,y=Mid Y,rotation=5,side=Layer,fitted=DNP`; `side=bottom` states "
        "the side of all parts, `rotation=none` that there is none.",
    )
    delimiter: str | None = Field(
        default=None, max_length=10, description="Of a centroid file: one character or its name."
    )
    step: str | None = Field(
        default=None, max_length=200, description="Step of an ODB++ design or IPC-2581 file: a board, or its panel."
    )
    repeat: str | None = Field(
        default=None, max_length=40, description="Of a file of one board: boards of the panel along x and y, as `3x2`."
    )
    pitch: str | None = Field(
        default=None, max_length=40, description="With `repeat`: distance from board to board, mm, as `30x28.5`."
    )
    rotate: str | None = Field(
        default=None, max_length=500, description="With `repeat`: rotations of the boards in turn, degrees, as `0,180`."
    )
    border: str | None = Field(
        default=None,
        max_length=40,
        description="With `repeat`: from the outermost boards to the edges of the panel, mm, as `0x5`.",
    )
    sizes: str | None = Field(
        default=None,
        max_length=40_000,
        description="Table of body sizes, in TOML: `[[package]]` with `pattern` and `size`.",
    )
    join: str | None = Field(
        default=None, pattern=PREVIEW_ID, description="Id of another preview, whose file has bodies and outline."
    )


class UploadOptions(ImportOptions):
    """The parameters of an upload."""

    filename: PlainText = Field(min_length=1, max_length=200, description="Name of the file, for messages.")


class ImportPreview(Strict):
    """An uploaded file, and the board type that it would make."""

    id: str
    filename: str
    size_bytes: int
    expires: str
    options: ImportOptions
    found: ImportOverview | None = Field(default=None, description="Absent if the file was refused.")
    refusal: str | None = Field(default=None, description="Why the file cannot be imported with these options.")
    picture: str | None = Field(default=None, description="Address of the picture, SVG.")
    board_type: str | None = Field(default=None, description="Address of the board type.")


class ImportPreviewList(Strict):
    """All previews, the oldest first."""

    previews: list[ImportPreview]
