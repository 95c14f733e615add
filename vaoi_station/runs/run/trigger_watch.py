"""Warnings from the trigger proofs of runs.

A doubt about the frames of a camera begins a warning. The next run that has frames of this camera without a doubt ends
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from vaoi_station.acquisition.pairing.proof import ACTIONS, TriggerFinding, doubtful
from vaoi_station.acquisition.process.messages import RunFinished
from vaoi_station.model import Reason


class TriggerChanges(NamedTuple):
    """The warnings that begin with a run, and the names of the cameras whose warnings end with it."""

    begun: tuple[Reason, ...]
    ended: tuple[str, ...]


class TriggerWatch:
    """The doubts about each camera in its newest proof. Used by the coordinator's thread only."""

    def __init__(self, names: Sequence[str]) -> None:
        """Begin without doubts; `names` are the cameras' names in messages."""
        self._names = tuple(names)
        self._warnings: dict[int, Reason] = {}

    def warnings(self) -> tuple[Reason, ...]:
        """Return one warning for each camera whose frames were in doubt in the newest run that it took part in."""
        return tuple(self._warnings[camera] for camera in sorted(self._warnings))

    def add(self, report: RunFinished) -> TriggerChanges:
        """Update the warnings with the proof of a finished run."""
        if report.proof is None:
            return TriggerChanges((), ())
        found: dict[int, TriggerFinding] = {}
        for finding in doubtful(report.proof):
            found.setdefault(finding.camera, finding)
        begun, ended = [], []
        for proof in report.proof.cameras:
            camera, before = proof.camera, self._warnings.pop(proof.camera, None)
            if camera in found:
                self._warnings[camera] = self._warning(report.run, found[camera])
                if before is None or before.code != self._warnings[camera].code:
                    begun.append(self._warnings[camera])
            elif before is not None and proof.frames:
                ended.append(self._names[camera])
            elif before is not None:
                # A run without a frame of the camera shows nothing new about its trigger.
                self._warnings[camera] = before
        return TriggerChanges(tuple(begun), tuple(ended))

    def _warning(self, run: str, finding: TriggerFinding) -> Reason:
        where = self._names[finding.camera] + ("" if finding.row is None else f", row {finding.row}")
        message = f"{where[0].upper()}{where[1:]}, run {run}: {finding.text}."
        return Reason(code=f"trigger-{finding.kind}", message=message, action=ACTIONS[finding.kind])
