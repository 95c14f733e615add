"""Comparison of the ids of one board: that the line was armed with, that was read, and that of the next machine."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from vaoi_station.model import Reason
from vaoi_station.model.board_identity import (
    ID,
    BoardIdentity,
    BoardReading,
    IdentityDocument,
    IdentityState,
    ReportedId,
)

_SHOWN = 60
"""Largest number of characters of a text in a message."""


def compare(
    identity: BoardIdentity | None,
    reading: BoardReading | None,
    armed: str | None,
    reported: ReportedId | None = None,
    *,
    skipped: Collection[str] = (),
    without: IdentityState = "not-read",
) -> IdentityDocument:
    """Compare the ids of one board. They are equal only if all their characters are."""
    read = reading or BoardReading()
    whole = sorted({c.board_id for c in read.codes if c.panel is None and c.board_id is not None})
    positions: dict[str, set[str]] = {}
    for code in read.codes:
        if code.panel is not None and code.board_id is not None:
            positions.setdefault(str(code.panel), set()).add(code.board_id)
    boards = {name: next(iter(ids)) for name, ids in positions.items() if len(ids) == 1}
    board_id = whole[0] if len(whole) == 1 else None
    differing = [*_contradictions(identity, read, whole, positions), *_differences(board_id, armed, reported)]
    missing = [] if identity is None or reading is None else [*_unread(identity, read, whole, {*positions, *skipped})]
    state: IdentityState
    if differing:
        state = "differs"
    elif identity is None:
        state = "not-expected"
    elif reading is None:
        state = without
    elif missing:
        state = "unread"
    else:
        state = "agrees" if board_id is not None and (armed or reported) is not None else "not-compared"
    return IdentityDocument(
        state=state,
        board_id=board_id,
        boards=boards,
        armed_board_id=armed,
        next_machine=reported,
        read=reading is not None,
        required=identity is not None and identity.required,
        reasons=tuple(differing + missing),
        codes=read.codes,
        unread_places=read.unread_places,
        complete=read.complete,
    )


def _contradictions(
    identity: BoardIdentity | None, read: BoardReading, whole: list[str], positions: Mapping[str, Collection[str]]
) -> Iterator[Reason]:
    """Yield what contradicts itself on the board, or shows another product."""
    stated = [("the board", whole), *((f"position {n} of the panel", sorted(ids)) for n, ids in positions.items())]
    for what, ids in stated:
        if len(ids) < 2:
            continue
        names = ", ".join(_shown(name) for name in ids)
        yield Reason(
            code="codes-disagree",
            message=f"The codes of {what} state {len(ids)} ids: {names}.",
            action="Check the labels, and whether the board is of this type.",
        )
    # Anywhere on a board there may be codes of its components as well.
    foreign = [c.text for c in read.codes if c.board_id is None] if identity is not None and identity.places else []
    if identity is not None and foreign:
        yield Reason(
            code="product-differs",
            message=f"A code at a place of the type is {_shown(foreign[0])}, not {_shown(identity.pattern or ID)}.",
            action="Check which product passes, and arm for its board type.",
        )


def _differences(board_id: str | None, armed: str | None, reported: ReportedId | None) -> Iterator[Reason]:
    """Yield which ids from different sources differ."""
    if board_id is not None and armed is not None and board_id != armed:
        yield Reason(
            code="board-id-differs",
            message=f"The board's code states {_shown(board_id)}, the line was armed with {_shown(armed)}.",
            action="Identify the board; arm again with the id of the next one.",
        )
    known, source = (board_id, "the board's code") if board_id is not None else (armed, "the order of the line")
    if reported is not None and known is not None and reported.board_id != known:
        machine = reported.machine or "the next machine"
        yield Reason(
            code="next-machine-differs",
            message=f"The id of {machine} is {_shown(reported.board_id)}, that of {source} {_shown(known)}.",
            action="Identify the board, and check whether a board was taken out or put in between the machines.",
        )


def _unread(
    identity: BoardIdentity, read: BoardReading, whole: list[str], positions: Collection[str]
) -> Iterator[Reason]:
    """Yield which boards have no id, because none of their codes was read; `positions` are those that need none."""
    panels = {str(place.panel) for place in identity.places if place.panel is not None} - {*positions}
    named = any(place.panel is None for place in identity.places) or not identity.places
    without = [
        *(["the board"] if named and not whole else []),
        *(f"position {name} of the panel" for name in sorted(panels)),
    ]
    if without:
        cut = "" if read.complete else " before the time for reading ended"
        others = [] if identity.places else [c.text for c in read.codes]
        found = f" Codes without an id of this product: {', '.join(map(_shown, others[:3]))}." if others else ""
        yield Reason(
            code="code-unread",
            message=f"No code was read of {', '.join(without)}{cut}.{found}",
            action="Check label, focus and light; state the places of codes in the board type.",
        )


def _shown(text: str) -> str:
    """Return a text as it is shown in messages: in quotes, with control characters escaped, and not too long."""
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…")
