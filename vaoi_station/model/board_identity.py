"""The identity of a board: where its codes are and what they state, and what was read from a run."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from vaoi_station.model.frozen_model import Finite, FrozenModel, Point, Positive, Strict
from vaoi_station.model.reason import Reason

Symbology = Literal["datamatrix", "qr"]
ID, ANY = "{id}", "{any}"
"""In a pattern, what stands for the id of the board, and for any other text."""
_MOST_PLACES, _MOST_ANY = 200, 16
Panel = str | int | None


class CodePlace(FrozenModel):
    """A rectangle of the board, along the CAD axes, in which a code is printed, with room for its tolerance."""

    center: Point
    """CAD coordinates of its middle."""
    width: Positive
    """Extent along CAD x."""
    height: Positive
    """Extent along CAD y."""
    panel: Panel = None
    """Position on the panel of the board that the code belongs to; None: the whole board or panel."""


class BoardIdentity(FrozenModel):
    """The key `identity` of board.json: the codes that a board carries, and what they state."""

    pattern: Annotated[str, Field(min_length=4, max_length=400)] | None = None
    """Text of this product's codes: `{id}` stands for the id, `{any}` for any text; None: the whole text is the id."""
    places: tuple[CodePlace, ...] = ()
    """Where the codes are; empty: anywhere on the board."""
    symbology: Symbology | None = None
    """Kind of the codes; None: DataMatrix and QR."""
    required: bool = False
    """Whether a run is degraded if its id was not read, or differs."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.places) > _MOST_PLACES:
            raise ValueError(f"places has {len(self.places)} entries, the limit is {_MOST_PLACES}")
        pattern = ID if self.pattern is None else self.pattern
        if pattern.count(ID) != 1:
            raise ValueError(f"pattern {pattern!r} has {ID} {pattern.count(ID)} times, must have it once")
        if pattern.count(ANY) > _MOST_ANY:
            raise ValueError(f"pattern {pattern!r} has {ANY} {pattern.count(ANY)} times, the limit is {_MOST_ANY}")
        if any(pair in pattern for pair in (ID + ANY, ANY + ID, ANY + ANY)):
            raise ValueError(f"pattern {pattern!r} has {ID} or {ANY} side by side, must have a text between them")
        return self

    def board_id(self, text: str) -> str | None:
        """Return the id that the text of a code states; None if it is no code of this product.

        Each `{any}` and `{id}` is the shortest text of one or more characters after which the next part follows.
        """
        if self.pattern is None:
            return text or None
        parts = self.pattern.replace(ID, ANY).split(ANY)
        wanted = self.pattern[: self.pattern.index(ID)].count(ANY)
        if not text.startswith(parts[0]) or not text.endswith(parts[-1]):
            return None
        begins, end, found = len(parts[0]), len(text) - len(parts[-1]), ""
        for number, part in enumerate(parts[1:]):
            ends = end if number == len(parts) - 2 else text.find(part, begins + 1, end)
            if ends <= begins:
                return None
            if number == wanted:
                found = text[begins:ends]
            begins = ends + len(part)
        return found


class BoardCode(Strict):
    """A code that was read from a run. Places are CAD coordinates in the unit of the board type."""

    text: str
    symbology: Symbology
    board_id: str | None = None
    """The id that the text states; None if it is no code of the board type's product."""
    panel: Panel = None
    center: tuple[Finite, Finite]
    corners: tuple[Point, Point, Point, Point]
    """Corners of the code, going round from its own top left one."""
    module_mm: Positive
    """Side of one module."""
    error_correction_used: Annotated[Finite, Field(ge=0, le=1)]
    """Share of the code's error correction that was needed: 0 if every module was read right, 1 at its limit."""
    camera: int | None = None
    row: int | None = None
    """The frame that shows it best; both None if it was put together from several frames."""


class BoardReading(Strict):
    """The codes that were read from one run."""

    codes: tuple[BoardCode, ...] = ()
    unread_places: tuple[CodePlace, ...] = ()
    """Places of the board type in which no code was read."""
    complete: bool = True
    """False if the time for reading ended before every picture was tried."""


def check_places(identity: BoardIdentity, low: Any, high: Any, margin: float) -> None:
    """Raise ValueError if the places of codes lie off the board, whose extent is `low` to `high`, in its unit."""
    for n, place in enumerate(identity.places):
        half = (place.width / 2, place.height / 2)
        for axis in (0, 1):
            if not low[axis] - margin <= place.center[axis] - half[axis]:
                break
            if not place.center[axis] + half[axis] <= high[axis] + margin:
                break
        else:
            continue
        raise ValueError(
            f"identity.places.{n} at {place.center}, {place.width:g}×{place.height:g}, reaches beyond the board, "
            f"({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g})"
        )


class ReportedId(Strict):
    """The id that the next machine of the line has read of the same board."""

    board_id: Annotated[str, Field(min_length=1, max_length=200)]
    machine: Annotated[str, Field(max_length=80)] = ""
    time: str = ""
    """Time of the report (UTC)."""


IdentityState = Literal["agrees", "differs", "unread", "not-compared", "not-expected", "pending", "not-read"]
"""All ids agree; some differ; a code was not read; no other id to compare with; the board type has no codes; the codes
are not read yet; they were not read, because the frames were needed or the run has no result."""


class IdentityDocument(Strict):
    """Which board a run shows: the ids from all sources, side by side; none replaces another."""

    state: IdentityState
    board_id: str | None = None
    """The id that was read from the board or panel; None if none was read, or its codes state several."""
    boards: dict[str, str] = Field(default_factory=dict)
    """On a panel: the id that was read of each board, by its position on the panel, unless its codes state several."""
    armed_board_id: str | None = None
    """The id that the line was armed with."""
    next_machine: ReportedId | None = None
    read: bool = False
    """Whether the codes were searched in the frames."""
    required: bool = False
    """Whether the board type demands that the id was read and does not differ."""
    reasons: tuple[Reason, ...] = ()
    codes: tuple[BoardCode, ...] = ()
    unread_places: tuple[CodePlace, ...] = ()
    complete: bool = True
    """False if the time for reading ended before every picture was tried."""

    @property
    def board_ids(self) -> tuple[str, ...]:
        """The ids by which the run is found: all that were read, and that of the next machine."""
        found = {self.board_id, *self.boards.values(), *(code.board_id for code in self.codes)}
        if self.next_machine is not None:
            found.add(self.next_machine.board_id)
        return tuple(sorted(name for name in found if name is not None))

    @property
    def degrades(self) -> bool:
        """Whether a run with this identity is degraded."""
        return self.required and self.state in ("differs", "unread", "not-read")

    @property
    def degrading(self) -> tuple[Reason, ...]:
        """Why a run with this identity is degraded; empty if it is not."""
        if not self.degrades:
            return ()
        return self.reasons if self.state != "not-read" else (*self.reasons, _NOT_READ)

    def without_reading(self) -> IdentityDocument:
        """Return the identity once its codes can no longer be read: `pending` becomes `not-read`."""
        return self.model_copy(update={"state": "not-read"}) if self.state == "pending" else self


_NOT_READ = Reason(
    code="identity-not-read",
    message="The codes of the board were not read.",
    action="Identify the board; give the station more memory for runs if its frames were needed (ring.runs).",
)
