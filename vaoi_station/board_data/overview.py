"""What an import has found: counts, what was recognised of a centroid file, what is missing, what to check."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from vaoi_station.board_data.design import Design, Side
from vaoi_station.model import BoardType, Strict
from vaoi_station.model.reason import Note


class ImportedColumn(Strict):
    """A column of a centroid file whose content was recognised."""

    name: str
    number: int = Field(description="From 1.")
    header: str | None = None


class ImportedTable(Strict):
    """What was recognised of a centroid file."""

    delimiter: str
    unit: str
    unit_from: str = Field(description="What states the unit.")
    columns: list[ImportedColumn]
    headers: list[str] = Field(default=[], description="Header of every column.")
    all_on: Side | None = Field(default=None, description="The side of all parts, as it was given.")


class MissingData(Strict):
    """Data that the file does not have."""

    what: Literal["outline", "fiducials", "sizes", "heights", "sides", "rotations"]
    count: int = Field(description="Number of components without it; of fiducials, those that are missing to two.")
    message: str


class ImportRemark(Strict):
    """What a person should check after an import."""

    code: str
    message: str
    values: dict[str, str] = Field(description="What the message states: numbers, designators and other names.")


class ImportOverview(Strict):
    """What an import has found."""

    name: str
    format: str
    side: Literal["top", "bottom"]
    parts_top: int
    parts_bottom: int
    components: int = Field(description="Components of the board type.")
    not_fitted: int
    fiducials: int
    other_marks: int
    cut_outs: int
    boards: int = Field(description="Of a panel: number of its boards; otherwise 0.")
    step: str | None = Field(default=None, description="Of ODB++ and IPC-2581: the step that was read.")
    steps: list[str] = Field(default=[], description="Steps that can be read: boards, and panels that repeat them.")
    size_mm: tuple[float, float] = Field(description="Extent along CAD x and y.")
    sizes_from: dict[str, int] = Field(description="Number of components whose size is from file, table or guess.")
    heights: int = Field(description="Number of components with a height.")
    table: ImportedTable | None = None
    missing: list[MissingData]
    check: list[ImportRemark] = Field(description="What a person should check.")


def overview(design: Design, board: BoardType, notes: tuple[Note, ...]) -> ImportOverview:
    """Describe an import: `board` is the board type of one side of `design`."""
    sides = Counter(part.side for part in design.parts)
    low, high = board.extent()
    return ImportOverview(
        name=board.name,
        format=design.format,
        side=board.side,
        parts_top=sides["top"],
        parts_bottom=sides["bottom"],
        components=len(board.components),
        not_fitted=sum(c.fitted is False for c in board.components),
        fiducials=len(board.fiducials),
        other_marks=len(board.other_marks or ()),
        cut_outs=len(board.cut_outs or ()),
        boards=sum(placed.position is not None for placed in design.boards),
        step=design.step,
        steps=list(design.steps),
        size_mm=(round(float(high[0] - low[0]), 3), round(float(high[1] - low[1]), 3)),
        sizes_from=dict(Counter(str(c.size_from) for c in board.components)),
        heights=sum(c.body_height is not None for c in board.components),
        table=_table(design),
        missing=list(_missing(design, board)),
        check=[ImportRemark(code=note.code, message=note, values=dict(note.values)) for note in notes],
    )


def _table(design: Design) -> ImportedTable | None:
    table = design.table
    if table is None:
        return None
    headers = dict(enumerate(table.headers, 1))
    columns = [ImportedColumn(name=name, number=n, header=headers.get(n)) for name, n in table.columns]
    return ImportedTable(
        delimiter=table.delimiter,
        unit=table.unit,
        unit_from=table.unit_from,
        columns=columns,
        headers=list(table.headers),
        all_on=table.all_on,
    )


def _missing(design: Design, board: BoardType) -> Iterator[MissingData]:
    """Yield what the board type lacks, the most important first."""
    count = len(board.components)
    if (lacking := 2 - len(board.fiducials)) > 0:
        yield MissingData(
            what="fiducials", count=lacking, message="A board is placed by two fiducials at least; add them by hand."
        )
    if board.outline is None:
        message = "Without an outline the orientation of boards is not checked; join a file that has it."
        yield MissingData(what="outline", count=1, message=message)
    if guessed := sum(c.size_from == "guess" for c in board.components):
        message = "Sizes are guessed; join a file with bodies, or give a table of sizes."
        yield MissingData(what="sizes", count=guessed, message=message)
    if flat := sum(c.body_height is None for c in board.components):
        message = "Without body heights, images are right on the board and less so on tall bodies."
        yield MissingData(what="heights", count=flat, message=message)
    known = dict(design.table.columns) if design.table else None
    sides = sorted({part.side for part in design.parts})
    stated = design.table is not None and design.table.all_on is not None
    if known is not None and "side" not in known and not stated and len(sides) == 1:
        message = f"No column states the side; all parts count as those of the {sides[0]}."
        yield MissingData(what="sides", count=count, message=message)
    if known is not None and "rotation" not in known:
        yield MissingData(what="rotations", count=count, message="No column states the rotation; 0° is taken.")
