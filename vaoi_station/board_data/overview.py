"""What an import has found: counts, what was recognised of a centroid file, what is missing, what to check."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from vaoi_station.board_data.design import Design, ImportedTable
from vaoi_station.model import BoardType, Strict
from vaoi_station.model.reason import Note

Missing = Literal["outline", "fiducials", "sizes", "heights", "sides", "rotations"]


class MissingData(Strict):
    """Data that the file does not have."""

    what: Missing
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
    test_points: int = Field(default=0, description="Pads and vias that a probe reaches on the side.")
    table: ImportedTable | None = None
    missing: list[MissingData]
    check: list[ImportRemark] = Field(description="What a person should check.")


def overview(design: Design, board: BoardType, notes: tuple[Note, ...]) -> ImportOverview:
    """Describe an import: `board` is the board type of one side of `design`."""
    low, high = board.extent()
    return ImportOverview(
        name=board.name,
        format=design.format,
        side=board.side,
        parts_top=len(design.parts_on("top")),
        parts_bottom=len(design.parts_on("bottom")),
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
        test_points=0 if board.test_points is None else len(board.test_points.name),
        table=design.table,
        missing=[MissingData(what=what, count=count, message=text) for what, count, text in _missing(design, board)],
        check=[ImportRemark(code=note.code, message=note, values=dict(note.values)) for note in notes],
    )


def _missing(design: Design, board: BoardType) -> Iterator[tuple[Missing, int, str]]:
    count, table = len(board.components), design.table
    if (lacking := 2 - len(board.fiducials)) > 0:
        yield "fiducials", lacking, "A board is placed by two fiducials at least; add them by hand."
    if board.outline is None:
        yield "outline", 1, "Without an outline the orientation of boards is not checked; join a file that has it."
    if guessed := sum(c.size_from == "guess" for c in board.components):
        yield "sizes", guessed, "Sizes are guessed; join a file with bodies, or give a table of sizes."
    if flat := sum(c.body_height is None for c in board.components):
        yield "heights", flat, "Without body heights, images are right on the board and less so on tall bodies."
    sides = {part.side for part in design.parts}
    if table is not None and not table.has("side") and table.all_on is None and len(sides) == 1:
        yield "sides", count, f"No column states the side; all parts count as those of the {sides.pop()}."
    if table is not None and not table.has("rotation"):
        yield "rotations", count, "No column states the rotation; 0° is taken."
