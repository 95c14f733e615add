"""Decide the verdict of a run: from its result, faults of the line, doubts about its frames and the board's identity.

`decide_verdict` decides it when the run ends, and again when the codes of its board were read or another machine has
reported an id. It is stored both times. The status of a stitched result is decided by `judge_result`, in the worker;
`with_faults` lowers the stored one, and `plant/restitch.py` that of a run which is stitched again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, TypeVar

from vaoi_station.acquisition.pairing.proof import ACTIONS, QUESTIONING_KINDS, TriggerProof, doubtful, doubts_of
from vaoi_station.files.results import stitch_text
from vaoi_station.model import Reason, Status, Stitch, Verdict
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.schemas import IdentitySummary, RunSummary
from vaoi_station.runs.states.tables import FINISHED, RunState
from vaoi_station.runs.workers.jobs import Concluded

D = TypeVar("D", bound=RunSummary)


class RunVerdict(NamedTuple):
    """The verdict of a run, None while there is no result, with its reasons and notes that do not lower it."""

    status: Status | None
    reasons: tuple[Reason, ...]


def decide_verdict(
    result: Status | None,
    reasons: tuple[Reason, ...],
    *,
    doubted: bool = False,
    identity: IdentityDocument | None = None,
) -> RunVerdict:
    """Decide the verdict of a run that has ended, from that of its result (None: it has none).

    `doubted`: whether faults of the line, or doubts about its frames, are among the reasons.
    """
    against = identity.degrading if identity is not None else ()
    status = Status.FAILED if result is None else result
    if status is Status.OK and (doubted or against):
        status = Status.DEGRADED
    return RunVerdict(status, (*reasons, *(reason for reason in against if reason not in reasons)))


def conclude(progress: Progress) -> RunVerdict:
    """Return the verdict of a run before the identity of its board is known; while it is under way, its reasons."""
    stitch, reasons = progress.stitch, (*_reasons(progress), *progress.order.notes)
    if stitch is None and progress.state not in FINISHED:
        return RunVerdict(None, reasons)
    doubted = bool(progress.faults) or (progress.head is not None and bool(progress.head.doubts))
    return decide_verdict(stitch.status if stitch else None, reasons, doubted=doubted)


def identified(document: D, before: RunVerdict, identity: IdentityDocument | None) -> D:
    """Return the document of a run with the verdict that the identity of its board leaves; `before` is without it."""
    if identity is None:
        return document
    verdict = before if before.status is None else decide_verdict(before.status, before.reasons, identity=identity)
    state = document.state
    if state in (RunState.READY, RunState.DEGRADED):
        state = RunState.READY if verdict.status is Status.OK else RunState.DEGRADED
    summary = IdentitySummary.of(identity)
    changes = {"verdict": verdict.status, "reasons": verdict.reasons, "state": state, "identity": summary}
    return document.model_copy(update=changes)


def with_faults(result: Concluded, faults: list[Reason]) -> Concluded:
    """Return a result with the faults of its run: callers that read only the matrices must notice them."""
    if not faults or result.without_components.status is not Status.OK:
        return result
    whole = Stitch.model_validate_json(result.document)
    changes = {
        "status": Status.DEGRADED,
        "reasons": (*whole.reasons, *(fault.message for fault in faults)),
        "reason_codes": (*whole.reason_codes, *(fault.code for fault in faults)),
    }
    slim = result.without_components.model_copy(update=changes)
    return Concluded(slim, stitch_text(whole.model_copy(update=changes)))


def _trigger_reasons(proof: TriggerProof | None) -> Iterator[Reason]:
    """Yield a reason for each finding of the trigger proof that is a doubt; others only explain missing frames."""
    for f in doubtful(proof):
        where = f"Camera {f.camera}" if f.row is None else f"Camera {f.camera}, row {f.row}"
        unused = ""
        if f.kind in QUESTIONING_KINDS:
            unused = " Its frames are not used." if f.row is None else " The frame is not used."
        yield Reason(code=f"trigger-{f.kind}", message=f"{where}: {f.text}.{unused}", action=ACTIONS[f.kind])


def _reasons(progress: Progress) -> Iterator[Reason]:
    stitch, proof = progress.stitch, progress.recorded.proof if progress.recorded else None
    # Doubts of the proof and faults of the run are reasons of the result too. Here they have codes and actions.
    known = {*doubts_of(proof), *(fault.message for fault in progress.faults)}
    if stitch:
        codes = stitch.reason_codes or ("",) * len(stitch.reasons)
        for text, code in zip(stitch.reasons, codes, strict=True):
            if text not in known:
                yield Reason(code=f"stitch-{stitch.status}", message=text, cause=code)
    # Lost frames lower no verdict here: where they matter, the result has a reason of its own.
    bad = [f for _, f in sorted(progress.frames.items()) if f.verdict is not Verdict.OK]
    for verdict, cause in sorted({(f.verdict, f.cause) for f in bad}):
        where = ", ".join(f"({f.camera}, {f.row})" for f in bad if (f.verdict, f.cause) == (verdict, cause))
        yield Reason(code=f"frames-{verdict}", message=f"Frames (camera, row) {where} are {verdict}: {cause}.")
    yield from _trigger_reasons(proof)
    yield from progress.faults
