"""Schemas of the identity of a run, as its document states it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from vaoi_station.model.board_identity import IdentityDocument, IdentityState


class IdentitySummary(BaseModel):
    """Which board a run shows, in short; `runs/{id}/identity` has reasons and codes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    state: IdentityState
    board_id: str | None = None
    """The id that was read from the board's code; `board_id` of the run is the one that the line was armed with."""
    boards: dict[str, str] = {}
    """On a panel: the id that was read of each board, by its position."""

    @staticmethod
    def of(document: IdentityDocument) -> IdentitySummary:
        """Return the summary of an identity."""
        return IdentitySummary(state=document.state, board_id=document.board_id, boards=document.boards)
