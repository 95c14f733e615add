"""Documents of runs from the database. However old or unfinished a record is, it never prevents the station's start."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

from pydantic import ValidationError

from vaoi_station.errors import DeviceError
from vaoi_station.model import Reason
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import summary_of
from vaoi_station.runs.run.verdict import decide_verdict
from vaoi_station.runs.states.schemas import RunDetail, RunSummary, VerdictCounts
from vaoi_station.runs.states.tables import IN_MEMORY, RunState
from vaoi_station.store import RunRow
from vaoi_station.store.documents import IdentityRow

R = TypeVar("R", RunSummary, RunDetail)
_LOST = Reason(code="station-restarted", message="The station ended before this run had a result.")
_UNREADABLE = Reason(
    code="record-unreadable",
    message="The record of this run cannot be read by this version of the station.",
    action="Read it with the version that wrote it.",
)


def row_of(
    progress: Progress, detail: RunDetail, finish_number: int | None = None, identity: IdentityDocument | None = None
) -> RunRow:
    """Return the row of a run; `finish_number` is None while it is under way."""
    return RunRow(
        id=detail.id,
        state=detail.state,
        finish_number=finish_number,
        board_type_digest=progress.order.board_type_digest,
        calibration_digest=progress.order.calibration_digest,
        summary=summary_of(detail).model_dump_json(),
        detail=detail.model_dump_json(),
        head=progress.head.model_dump_json() if progress.head else None,
        identity=None if identity is None else identity_row(identity),
    )


def identity_row(identity: IdentityDocument) -> IdentityRow:
    """Return the row of an identity."""
    document = identity.model_dump_json(exclude_none=True)
    return IdentityRow(document, identity.board_ids, pending=identity.state == "pending")


def state_of(row: RunRow) -> RunState:
    """Return the state of a stored run; a state that this version does not know counts as `gone`."""
    try:
        return RunState(row.state)
    except ValueError:
        return RunState.GONE


def in_state(document: R, state: RunState) -> R:
    """Return a copy of a run's document with another state."""
    available = state in IN_MEMORY
    kept = {} if available else {"frames_kept_until": None}
    return document.model_copy(update={"state": state, "frames_available": available, **kept})


def identity(text: str | None) -> IdentityDocument | None:
    """Return a stored identity; None if there is none. One of another version counts as not read."""
    try:
        return None if text is None else IdentityDocument.model_validate_json(text)
    except ValidationError:
        return IdentityDocument(state="not-read", required=True)


def decided(detail: str, summary: str) -> RunDetail:
    """Return the document of a run from its two stored texts: the summary has the verdict with the identity."""
    shown = RunSummary.model_validate_json(summary)
    changes = {"verdict": shown.verdict, "reasons": shown.reasons, "identity": shown.identity}
    return RunDetail.model_validate_json(detail).model_copy(update=changes)


def summary(row: RunRow, state: RunState) -> RunSummary:
    """Return the summary of a stored run in a state. If it cannot be read, return a summary that states this."""
    try:
        document = in_state(RunSummary.model_validate_json(row.summary), state)
        return document.model_copy(update={"forgotten": not row.detail})
    except ValidationError:
        return RunSummary(
            id=row.id,
            board_type="",
            board_id=None,
            job_id=None,
            state=state,
            verdict=None,
            started="",
            finished=None,
            rows=0,
            cameras=0,
            counts=VerdictCounts(ok=0, incomplete=0, missing=0),
            reasons=(_UNREADABLE,),
            belt=None,
            timings=None,
            frames_available=False,
        )


@contextmanager
def readable(run: str) -> Iterator[None]:
    """Raise DeviceError if a document of this run cannot be read in the `with` block, or contradicts another one."""
    try:
        yield
    except (ValidationError, IndexError) as error:  # IndexError: a camera that the calibration does not have
        raise DeviceError(
            f"Run {run}: {_UNREADABLE.message}", action=_UNREADABLE.action, code=_UNREADABLE.code
        ) from error


def cut_short(row: RunRow, finish_number: int) -> RunRow:
    """Return the row of a run that had not ended when the station ended, marked as failed, whatever its state was."""
    # The table of steps is not used: if the last write was lost, a row may have any state. No row may prevent the
    # start.
    ended = replace(row, state=RunState.GONE, finish_number=finish_number)
    try:
        document = RunDetail.model_validate_json(row.detail)
    except ValidationError:
        return ended
    reasons = (*document.reasons, _LOST)
    verdict = decide_verdict(None, reasons)
    changes = {"verdict": verdict.status, "reasons": verdict.reasons, "stored": True}
    document = in_state(document, RunState.GONE).model_copy(update=changes)
    return replace(ended, summary=summary_of(document).model_dump_json(), detail=document.model_dump_json())
