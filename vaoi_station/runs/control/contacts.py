"""The neighbours by the contacts of IPC-SMEMA-9851: how boards came, and which are offered to the next machine.

Contacts name no boards: boards leave in the order in which they came, and what is offered is the first of them whose
run has ended. "failed board available" closes for a board that came as failed, that was not filmed, or whose run has
no result that may be used (verdict failed); "board available" for every other one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from random import randrange
from typing import Any
from uuid import uuid4

from pydantic import TypeAdapter, ValidationError

from vaoi_station.acquisition.controller.announced import Came
from vaoi_station.acquisition.controller.interface import BoardOffer, Contacts
from vaoi_station.acquisition.process.messages import OfferBoard
from vaoi_station.errors import StateError
from vaoi_station.line_config import Smema
from vaoi_station.model import Reason
from vaoi_station.runs.control.readiness import RENEW_S, VALID_S
from vaoi_station.runs.states.schemas import BoardBehind, ContactsStatus
from vaoi_station.store.documents import KeyedTexts

_LARGEST, _KEY = 0xFFFF, "contacts"
_STORED = TypeAdapter(tuple[int, bool, bool, tuple[tuple[str, bool, int], ...]])
"""Number of the latest offer, whether its board is on offer, whether the order is in doubt, and the boards."""
_MOST_BAD, _MOST_BEHIND = 256, 20
"""Number of the latest runs of failed boards that are known; most boards behind the cameras with names."""


@dataclass
class _Behind:
    """A board between the barrier and the next machine."""

    name: str
    """Id of its run, or one made for a board that was not filmed."""
    failed: bool
    ended: bool
    count: int = 1
    """Number of boards that leave one after the other for this entry: those behind the first have lost theirs."""


class LineContacts:
    """Used by the coordinator's thread only, except `came_failed`."""

    def __init__(
        self,
        config: Smema | None,
        send: Callable[[OfferBoard], None],
        publish: Callable[..., Any],
        documents: KeyedTexts | None = None,
    ) -> None:
        """Begin with the boards that stood behind the cameras when the station ended.

        `config` is the table [smema], `publish` is like `EventLog.add`, and `documents` keeps the boards.
        """
        self._config, self._send, self._publish = config, send, publish
        self._exit_s = config.exit_s if config is not None and config.sides == "both" else None
        self._documents, self._kept = documents, ""
        self._behind: deque[_Behind] = deque()
        number, offered, self._doubtful = 0, False, False
        if self._exit_s is not None and documents is not None:
            self._kept = documents.get(_KEY) or ""
            with suppress(ValidationError):  # none are kept, or by another version
                number, offered, self._doubtful, kept = _STORED.validate_json(self._kept)
                self._behind.extend(_Behind(name, failed, ended=True, count=count) for name, failed, count in kept)
        self._failed: tuple[str, ...] = ()
        # The controller goes on watching the board of the process before, by its number.
        self._number = number if self._behind else randrange(_LARGEST)
        self._offered: _Behind | None = self._behind[0] if offered and self._behind else None
        self._seen: int | None = None if self._offered is None else (number - 2) % _LARGEST + 1
        """The number of the board before the one on offer, as the controller states it; None: not known."""
        self._renewed_s = float("-inf")

    def came_failed(self, run: str) -> bool:
        """Return whether the board of a run came as failed, as known of the latest runs. Any thread may ask.

        "": whether a board that was not filmed may have.
        """
        return run in self._failed or (not run and self._config is not None)

    def began(self, run: str, came: Came | None) -> None:
        """Take that a board is filmed, and how the line announced it."""
        if came == "failed":
            self._failed = (*self._failed, run)[-_MOST_BAD:]
            self._publish("line", "The board of this run came as a failed board.", run=run, code="board-came-failed")
        elif came == "by-hand" and self._config is not None:
            message = "The board of this run was put in by hand: the machine upstream has not announced it."
            action = (
                "If it was not put in by hand, check the contact board available of the machine upstream (vaoi doctor)."
            )
            self._publish("line", message, run=run, code="board-by-hand", action=action)
        self._add(_Behind(run, came == "failed", ended=False))

    def ended(self, run: str, *, failed: bool) -> None:
        """Take that a run has ended and its result is safe; `failed` is whether its board leaves as a failed one."""
        for board in self._behind:
            if board.name == run:
                board.failed, board.ended = board.failed or failed, True

    def controller_reset(self) -> None:
        """Take that the controller does not know whether the next machine has the board that is on offer.

        It may be offered again without being there: each board behind it would leave with the result of another one.
        """
        if self._offered is None or not self._behind:
            return
        for board in self._behind:
            board.failed = True
        self._renewed_s = float("-inf")
        if not self._doubtful:
            self._doubtful = True
            text = "It is not known whether the next machine has the board that was on offer: all leave as failed ones."
            action = "Take out all boards behind the cameras, and say on the page that they are out."
            self._publish("trouble", text, code="board-between-machines", action=action)

    def missed(self, count: int, run: str | None) -> None:
        """Take that boards passed without a run, behind the board of a run or, with None, behind all."""
        at = next((n + 1 for n, board in enumerate(self._behind) if board.name == run), len(self._behind))
        for _ in range(count):
            self._add(_Behind(f"missed-{uuid4().hex[:8]}", failed=True, ended=True), at)

    def remove(self, name: str) -> None:
        """Take that a board was taken out behind the cameras. `StateError`: it is not there."""
        board = next((board for board in self._behind if board.name == name and board.ended), None)
        if board is None:
            message = f"Board {name!r} does not wait for the next machine."
            raise StateError(message, action="Read the boards with GET neighbours.")
        self._left(board)

    def update(self, contacts: Contacts | None, now_s: float) -> None:
        """Offer the board that is due, renew or withdraw an offer; `contacts` are those of the latest report."""
        if self._exit_s is None:
            return
        if contacts is not None:
            if self._offered is not None and contacts.taken == self._number:
                if self._offered in self._behind:
                    self._left(self._offered)
                self._offered = None
            elif self._seen not in (None, contacts.taken):
                self.controller_reset()
            self._seen = contacts.taken
        else:  # it is not known what was taken meanwhile: an offer runs out
            self._keep()
            return
        due = self._behind[0] if self._behind and self._behind[0].ended else None
        fresh, self._offered = due is not self._offered, due
        if fresh and due is not None:
            self._number = self._number % _LARGEST + 1
            if self._number == self._seen:  # it would count as taken at once
                self._number = self._number % _LARGEST + 1
        self._keep()
        if due is None and fresh:
            self._send(OfferBoard(None))
        elif due is not None and (fresh or now_s - self._renewed_s >= RENEW_S):
            self._renewed_s = now_s
            self._send(OfferBoard(BoardOffer(self._number, due.failed, now_s + VALID_S, self._exit_s)))

    def _keep(self) -> None:
        """Keep the boards for the next start. One whose run has not ended by then leaves as a failed one."""
        offered = self._offered is not None and self._offered in self._behind
        boards = tuple((b.name, b.failed or not b.ended, b.count) for b in self._behind)
        now = _STORED.dump_json((self._number, offered, self._doubtful, boards)).decode()
        if now != self._kept and self._documents is not None:
            self._kept = now
            self._documents.set(_KEY, now)

    def held(self) -> tuple[Reason, ...]:
        """Return the reason that there is no room behind the cameras; empty if there is."""
        inside = sum(board.count for board in self._behind)
        if self._config is None or self._exit_s is None or inside < self._config.places:
            return ()
        message = f"{inside} boards are in the station, and the next machine has not taken the first."
        return (Reason(code="boards-wait", message=message, action="Wait, or look at the next machine."),)

    def status(self, contacts: Contacts | None) -> ContactsStatus | None:
        """Return contacts and boards for callers; None without [smema]."""
        if self._config is None:
            return None
        seen = contacts or Contacts()
        return ContactsStatus(
            known=contacts is not None,
            available=seen.available,
            failed=seen.failed,
            next_ready=seen.next_ready if self._exit_s is not None else None,
            offered="failed" if seen.offered_failed else "available" if seen.offered else "none",
            boards=tuple(BoardBehind(name=b.name, failed=b.failed) for b in self._behind if b.ended),
        )

    def _add(self, board: _Behind, at: int | None = None) -> None:
        if self._exit_s is None:
            return
        board.failed = board.failed or self._doubtful
        self._behind.insert(len(self._behind) if at is None else at, board)
        if len(self._behind) > _MOST_BEHIND:
            first, lost = self._behind[0], self._behind[1]
            del self._behind[1]
            first.count += lost.count
            for each in self._behind:
                each.failed = True
            text = (
                f"Board {lost.name} is forgotten: {_MOST_BEHIND} others wait for the next machine; all leave as failed."
            )
            action = "See why the next machine takes none. Say on the page which boards were taken out."
            self._publish("trouble", text, code="boards-wait", action=action)

    def _left(self, board: _Behind) -> None:
        """Take that a board is not behind the cameras any more."""
        board.count -= 1
        if not board.count:
            self._behind.remove(board)
        self._doubtful = self._doubtful and bool(self._behind)
