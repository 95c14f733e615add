"""The proof of a run: every frame belongs to its pulse, or what speaks against it is named.

A frame is given to a pulse by time alone, on the host's clock. Three independent witnesses are heard afterwards: the
camera's own clock against the controller's, to microseconds; the camera's count of its frames; and causality, for no
frame can arrive before its pulse. Pure logic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Literal

from vaoi_station.acquisition.causes import Gap, straightened
from vaoi_station.acquisition.pairing.clock_fit import middle, residuals_s, steady_interval_s
from vaoi_station.acquisition.pairing.records import KnownPulse, Seen
from vaoi_station.model import Noun

LIMIT_S = 200e-6
"""Frames of a triggered camera keep time with the pulses to this; jitter is some 10 µs."""
Kind = Literal["runs-freely", "extra-frame", "ignored-trigger", "exchanged", "off-beat", "early", "miscounted"]
QUESTIONS: frozenset[Kind] = frozenset({"runs-freely", "exchanged", "off-beat", "early", "miscounted"})
"""Findings by which a frame may be of another moment than its row's pulse."""


class TriggerFinding(Noun):
    """Something about one camera, or one of its rows, that is not as it should be."""

    camera: int
    row: int | None
    """None: it is about all of them."""
    kind: Kind
    text: str


class CameraProof(Noun):
    """One camera's witnesses."""

    camera: int
    pulses: int
    frames: int
    """Whole frames that have a row."""
    extra: int
    """Frames that have none."""
    max_residual_us: float | None
    """Camera's clock against the controller's, after a straight line; None for fewer than two frames."""
    latency_us: float | None
    """Median of time stamp minus pulse, by way of the host's clock."""
    proven: bool


class TriggerProof(Noun):
    """Every frame of a run belongs to its pulse, or `findings` name what speaks against it."""

    proven: bool
    limit_us: float = LIMIT_S * 1e6
    cameras: tuple[CameraProof, ...]
    findings: tuple[TriggerFinding, ...]


def prove(
    pulses: Mapping[int, KnownPulse],
    pulse_bound_s: float,
    seen: Sequence[Sequence[Seen]],
    gaps: Sequence[Sequence[Gap]],
) -> TriggerProof:
    """Hear all witnesses.

    Args:
        pulses: row → pulse, of all rows that were fired and told.
        pulse_bound_s: how far a pulse's host time may be off.
        seen: whole frames of every camera, those of no row included.
        gaps: what every camera's count says (`causes.gaps`).
    """
    cameras, findings = [], []
    for camera, (frames, between) in enumerate(zip(seen, gaps, strict=True)):
        placed = sorted((f for f in frames if f.row is not None), key=lambda f: f.row or 0)
        off = _residuals(pulses, placed)
        extra = sorted((f for f in frames if f.row is None), key=lambda f: f.host_s)
        found = _Camera(camera, pulses, pulse_bound_s, placed, extra, off, between).findings()
        findings += found
        cameras.append(
            CameraProof(
                camera=camera,
                pulses=len(pulses),
                frames=len(placed),
                extra=len(extra),
                max_residual_us=max(map(abs, off.values())) * 1e6 if len(off) > 1 else None,
                latency_us=_latency_s(pulses, placed) * 1e6 if placed else None,
                proven=not any(f.kind in QUESTIONS for f in found),
            )
        )
    proven = all(c.proven for c in cameras)
    return TriggerProof(proven=proven, cameras=tuple(cameras), findings=tuple(findings))


class _Camera:
    """The witnesses of one camera."""

    def __init__(
        self,
        camera: int,
        pulses: Mapping[int, KnownPulse],
        pulse_bound_s: float,
        placed: Sequence[Seen],
        extra: Sequence[Seen],
        off_s: Mapping[int, float],
        gaps: Sequence[Gap],
    ) -> None:
        self._camera, self._pulses, self._bound_s, self._gaps = camera, pulses, pulse_bound_s, gaps
        self._placed, self._extra, self._off_s = placed, extra, off_s

    def findings(self) -> list[TriggerFinding]:
        """Everything there is to say; of a camera that runs freely nothing else."""
        freely = self._runs_freely()
        if freely is not None:
            return [freely]
        found = [*self._off_beat(), *self._exchanged(), *self._early(), *self._counted(), *self._extras()]
        once: dict[tuple[int | None, Kind], TriggerFinding] = {}
        for finding in found:
            once.setdefault((finding.row, finding.kind), finding)
        return list(once.values())

    def _say(self, row: int | None, kind: Kind, text: str) -> TriggerFinding:
        return TriggerFinding(camera=self._camera, row=row, kind=kind, text=text)

    def _runs_freely(self) -> TriggerFinding | None:
        """Its frames come by a clock, but not by the controller's."""
        off = [row for row, s in self._off_s.items() if abs(s) > LIMIT_S]
        if not (off or self._extra):
            return None
        frames = sorted((f for f in [*self._placed, *self._extra] if f.frame_id is not None), key=lambda f: f.time_s)
        if len({f.epoch for f in frames}) != 1:
            return None
        interval_s = steady_interval_s([f.time_s for f in frames], [f.frame_id or 0 for f in frames])
        if interval_s is None or (not off and self._answers_every_pulse()):
            return None
        text = (
            f"it sends a frame every {interval_s * 1e3:.1f} ms whatever is fired: it runs freely, or by another trigger"
        )
        return self._say(None, "runs-freely", text)

    def _answers_every_pulse(self) -> bool:
        """Then what it sends besides lies between the pulses, and is extra."""
        first_s, last_s = (edge(p.host_s for p in self._pulses.values()) for edge in (min, max))
        inside = all(first_s < f.host_s < last_s for f in self._extra)
        return inside and len(self._placed) == len(self._pulses)

    def _off_beat(self) -> list[TriggerFinding]:
        return [
            self._say(
                row,
                "off-beat",
                f"its frame is dated {s * 1e6:+.0f} µs from where the camera's others say: it was exposed by "
                "something else than its pulse, or its time stamp is wrong",
            )
            for row, s in self._off_s.items()
            if abs(s) > LIMIT_S
        ]

    def _early(self) -> list[TriggerFinding]:
        """A frame that came before its pulse is another's: one of those that came after it and stand before it.

        A replay that does not wait for the clock tells of pulses before their time; there causality says nothing.
        """
        found = []
        for frame in self._placed:
            assert frame.row is not None
            fired_s = self._pulses[frame.row].host_s - self._bound_s
            before_s = fired_s - frame.arrived_s
            if before_s <= 0 or self._pulses[frame.row].heard_s < fired_s:
                continue
            text = f"its frame had arrived {before_s * 1e3:.1f} ms before its pulse was fired: it is of an earlier one"
            found.append(self._say(frame.row, "early", text))
            for other in self._placed:
                if other.row is not None and other.row < frame.row and other.arrived_s > frame.arrived_s:
                    text = f"its frame came after that of row {frame.row}, which came before its pulse: exchanged"
                    found.append(self._say(other.row, "exchanged", text))
        return found

    def _exchanged(self) -> list[TriggerFinding]:
        """By time they stand in one order, by number in another."""
        found = []
        for epoch in sorted({f.epoch for f in self._placed}):
            ids = {
                f.row: f.frame_id
                for f in self._placed
                if f.epoch == epoch and f.row is not None and f.frame_id is not None
            }
            straight = straightened(ids)
            rows_of = {frame_id: row for row, frame_id in straight.items()}
            found += [
                self._say(
                    row,
                    "exchanged",
                    f"its frame has the id {ids[row]}, which should be that of row {rows_of[ids[row]]}: "
                    "frames, or their time stamps, are exchanged",
                )
                for row in ids
                if ids[row] != straight[row]
            ]
        return found

    def _counted(self) -> list[TriggerFinding]:
        """What the count of the frames says of the pulses between two of them."""
        found = []
        for gap in self._gaps:
            if gap.ignored == 0:
                continue  # every pulse between was answered; what is missing was lost on the way
            if gap.ignored > len(gap.missing):
                text = f"its frame's id does not count the pulses since row {gap.before} {gap.span}"
                found.append(self._say(gap.after, "miscounted", text))
            elif gap.ignored == len(gap.missing):
                text = f"the camera did not answer its pulse {gap.span}"
                found += [self._say(row, "ignored-trigger", text) for row in gap.missing]
            elif gap.ignored > 0:
                rows = ", ".join(map(str, gap.missing))
                text = f"the camera did not answer {gap.ignored} of the pulses of rows {rows} {gap.span}"
                found.append(self._say(None, "ignored-trigger", text))
            elif gap.ignored < 0:
                more = f"{-gap.ignored} time(s) more than it was triggered"
                text = f"the camera exposed {more} since row {gap.before} {gap.span}"
                found.append(self._say(gap.after, "extra-frame", text))
        return found

    def _extras(self) -> list[TriggerFinding]:
        found = []
        for frame in self._extra:
            rows = [row for row, pulse in self._pulses.items() if pulse.host_s <= frame.host_s + self._bound_s]
            row = max(rows, default=None)
            since = "before the first pulse"
            if row is not None:
                since = f"{(frame.host_s - self._pulses[row].host_s) * 1e3:.1f} ms after the pulse of row {row}"
            number = f" (frame id {frame.frame_id})" if frame.frame_id is not None else ""
            text = f"the camera exposed once more than it was triggered, {since}{number}: its trigger line bounces"
            found.append(self._say(row, "extra-frame", text))
        return found


def _residuals(pulses: Mapping[int, KnownPulse], placed: Sequence[Seen]) -> dict[int, float]:
    """Row → how far its frame is off the camera's beat, s; every epoch has a clock of its own."""
    off: dict[int, float] = {}
    for epoch in {f.epoch for f in placed}:
        frames = [f for f in placed if f.epoch == epoch and f.row is not None]
        rows = [f.row for f in frames if f.row is not None]
        left = residuals_s([pulses[row].pulse.time_s for row in rows], [f.time_s for f in frames])
        off |= dict(zip(rows, left.tolist(), strict=True))
    return dict(sorted(off.items()))


def _latency_s(pulses: Mapping[int, KnownPulse], placed: Sequence[Seen]) -> float:
    return middle([f.host_s - pulses[f.row].host_s for f in placed if f.row is not None])


def rows_in_question(proof: TriggerProof, camera: int, rows: AbstractSet[int]) -> dict[int, str]:
    """Rows of a camera → what speaks against their frames."""
    notes: dict[int, str] = {}
    for finding in proof.findings:
        if finding.camera == camera and finding.kind in QUESTIONS:
            for row in rows if finding.row is None else rows & {finding.row}:
                notes[row] = f"{notes[row]}; {finding.text}" if row in notes else finding.text
    return notes
