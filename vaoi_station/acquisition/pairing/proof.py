"""The proof of a run: the check that every frame belongs to its pulse, with findings that contradict this. Pure logic.

Frames were assigned by time on the host's clock only. Three independent checks follow: the camera's time stamps fit the
pulse times to microseconds, its frame ids match the pulses, and no frame arrived before its pulse was fired.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Literal

from vaoi_station.acquisition.pairing.evidence import (
    ENOUGH,
    GATE_S,
    Gap,
    free_running_interval_s,
    in_counting_order,
    median,
    residuals_s,
)
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, ObservedPulse
from vaoi_station.model import FrozenModel

RESIDUAL_LIMIT_S = 200e-6
"""Largest accepted residual of a frame of a triggered camera against the pulses, s; real jitter is about 10 µs."""
CLOCK_SLACK_S = 1e-3
"""Error of both clocks between two readings, s, in addition to the bound at the newest reading."""
Kind = Literal[
    "runs-freely", "extra-frame", "ignored-trigger", "exchanged", "off-beat", "early", "miscounted",
    "latency-changed", "latency-ambiguous", "clock-jumped", "other-light",
]  # fmt: skip
QUESTIONING_KINDS: frozenset[Kind] = frozenset(
    {"runs-freely", "exchanged", "off-beat", "early", "miscounted", "latency-changed", "clock-jumped", "other-light"}
)
"""Kinds of findings that make it doubtful whether a frame was exposed by the pulse, and with the light, of its row."""


class TriggerFinding(FrozenModel):
    """A violation of the rule "one frame per pulse", found for a camera or for one row of a camera."""

    camera: int
    row: int | None
    """The row that the finding concerns; None if it does not concern one particular row."""
    kind: Kind
    text: str


class CameraProof(FrozenModel):
    """What the proof of a run measured on the frames of one camera."""

    camera: int
    pulses: int
    frames: int
    """Count of complete frames that are assigned to a row."""
    extra: int
    """Count of complete frames that are assigned to no row."""
    max_residual_us: float | None
    """Largest residual of the time stamps against the pulse times; None for fewer than two frames."""
    latency_us: float | None
    """Median of time stamp minus pulse time, both on the host's clock."""
    in_order_us: float | None = None
    """The latency at which all frames, unassigned ones too, follow the pulses one by one.

    None if there is no such latency, or if the frames were assigned with it."""
    proven: bool


class TriggerProof(FrozenModel):
    """The check that every frame of a run belongs to its pulse; `findings` state what contradicts it."""

    proven: bool
    limit_us: float = RESIDUAL_LIMIT_S * 1e6
    cameras: tuple[CameraProof, ...]
    findings: tuple[TriggerFinding, ...]


def prove(
    pulses: Mapping[int, ObservedPulse],
    pulse_bound_s: float,
    frames: Sequence[Sequence[ObservedFrame]],
    gaps: Sequence[Sequence[Gap]],
    unconfirmed: AbstractSet[int] = frozenset(),
) -> TriggerProof:
    """Check the frames of every camera against the pulses."""
    cameras, findings = [], []
    for camera, (observed, between) in enumerate(zip(frames, gaps, strict=True)):
        assigned = sorted((f for f in observed if f.row is not None), key=lambda f: f.row or 0)
        residuals = _residuals(pulses, assigned)
        extra = sorted((f for f in observed if f.row is None), key=lambda f: f.host_s)
        in_order_s = _in_order_s(pulses, pulse_bound_s, assigned, extra)
        if in_order_s is not None:
            found = [_latency_changed(camera, _latency_s(pulses, assigned) if assigned else None, in_order_s)]
        else:
            found = _CameraCheck(camera, pulses, pulse_bound_s, assigned, extra, residuals, between).findings()
            if camera in unconfirmed and not any(f.kind == "runs-freely" for f in found):
                found.append(_latency_ambiguous(camera, _latency_s(pulses, assigned) if assigned else None))
                if len(assigned) == 1 < len(pulses):
                    found.append(_unsupported(camera, assigned[0], _latency_s(pulses, assigned)))
        findings += found
        cameras.append(
            CameraProof(
                camera=camera,
                pulses=len(pulses),
                frames=len(assigned),
                extra=len(extra),
                max_residual_us=max(map(abs, residuals.values())) * 1e6 if len(residuals) > 1 else None,
                latency_us=_latency_s(pulses, assigned) * 1e6 if assigned else None,
                in_order_us=None if in_order_s is None else in_order_s * 1e6,
                proven=not any(f.kind in QUESTIONING_KINDS for f in found),
            )
        )
    proven = all(c.proven for c in cameras)
    return TriggerProof(proven=proven, cameras=tuple(cameras), findings=tuple(findings))


def questioned_rows(proof: TriggerProof, camera: int, rows: AbstractSet[int]) -> dict[int, str]:
    """Return {row: texts of findings} for those of the given rows of a camera whose frame is in doubt."""
    notes: dict[int, str] = {}
    for finding in proof.findings:
        if finding.camera == camera and finding.kind in QUESTIONING_KINDS:
            for row in rows if finding.row is None else rows & {finding.row}:
                notes[row] = f"{notes[row]}; {finding.text}" if row in notes else finding.text
    return notes


class _CameraCheck:
    def __init__(
        self,
        camera: int,
        pulses: Mapping[int, ObservedPulse],
        pulse_bound_s: float,
        assigned: Sequence[ObservedFrame],
        extra: Sequence[ObservedFrame],
        residuals_s: Mapping[int, float],
        gaps: Sequence[Gap],
    ) -> None:
        self._camera, self._pulses, self._bound_s, self._gaps = camera, pulses, pulse_bound_s, gaps
        self._assigned, self._extra, self._residuals_s = assigned, extra, residuals_s

    def findings(self) -> list[TriggerFinding]:
        """Return all findings, at most one per row and kind; for a free-running camera only this one finding."""
        free_running = self._free_running()
        if free_running is not None:
            return [free_running]
        found = [
            *self._off_beat(), *self._exchanged(), *self._early(), *self._miscounted(), *self._unassigned(),
        ]  # fmt: skip
        # Several checks may find the same fault. For each row and kind only the first finding is kept.
        once: dict[tuple[int | None, Kind], TriggerFinding] = {}
        for finding in found:
            once.setdefault((finding.row, finding.kind), finding)
        return list(once.values())

    def _finding(self, row: int | None, kind: Kind, text: str) -> TriggerFinding:
        return TriggerFinding(camera=self._camera, row=row, kind=kind, text=text)

    def _free_running(self) -> TriggerFinding | None:
        off = [row for row, s in self._residuals_s.items() if abs(s) > RESIDUAL_LIMIT_S]
        # The frames of a triggered camera come at equal intervals too. Only large residuals or unassigned frames show
        # that the camera follows another clock.
        if not (off or self._extra):
            return None
        frames = sorted((f for f in [*self._assigned, *self._extra] if f.frame_id is not None), key=lambda f: f.time_s)
        if len({f.epoch for f in frames}) != 1:
            return None
        interval_s = free_running_interval_s([f.time_s for f in frames], [f.frame_id or 0 for f in frames])
        if interval_s is None or (not off and self._answers_every_pulse()):
            return None
        text = f"it sends a frame every {interval_s * 1e3:.1f} ms, independent of the pulses: "
        return self._finding(None, "runs-freely", text + "it runs freely, or on another trigger")

    def _answers_every_pulse(self) -> bool:
        """Whether each pulse has a frame, and each unassigned frame lies between the first and the last pulse.

        The camera is then triggered, and its unassigned frames are extra exposures.
        """
        first_s, last_s = (edge(p.host_s for p in self._pulses.values()) for edge in (min, max))
        inside = all(first_s < f.host_s < last_s for f in self._extra)
        return inside and len(self._assigned) == len(self._pulses)

    def _off_beat(self) -> list[TriggerFinding]:
        return [
            self._finding(
                row,
                "off-beat",
                f"the time stamp of its frame is {s * 1e6:+.0f} µs off the line through the camera's other frames: "
                "something other than its pulse exposed it, or the time stamp is wrong",
            )
            for row, s in self._residuals_s.items()
            if abs(s) > RESIDUAL_LIMIT_S
        ]

    def _early(self) -> list[TriggerFinding]:
        found = []
        for frame in self._assigned:
            assert frame.row is not None
            fired_s = self._pulses[frame.row].host_s - self._bound_s
            before_s = fired_s - frame.arrived_s
            # A fast replay reports pulses before their time, so the order of arrival proves nothing.
            if before_s <= 0 or self._pulses[frame.row].reported_s < fired_s:
                continue
            text = f"its frame arrived {before_s * 1e3:.1f} ms before its pulse was fired: it is of an earlier pulse"
            found.append(self._finding(frame.row, "early", text))
            for other in self._assigned:
                if other.row is not None and other.row < frame.row and other.arrived_s > frame.arrived_s:
                    text = (
                        f"its frame arrived after that of row {frame.row}, which arrived before its own pulse: "
                        "the frames are exchanged"
                    )
                    found.append(self._finding(other.row, "exchanged", text))
        return found

    def _exchanged(self) -> list[TriggerFinding]:
        found = []
        for epoch in sorted({f.epoch for f in self._assigned}):
            ids = {
                f.row: f.frame_id
                for f in self._assigned
                if f.epoch == epoch and f.row is not None and f.frame_id is not None
            }
            ordered = in_counting_order(ids)
            row_of_id = {frame_id: row for row, frame_id in ordered.items()}
            found += [
                self._finding(
                    row,
                    "exchanged",
                    f"its frame has the id {ids[row]}, which should be that of row {row_of_id[ids[row]]}: "
                    "frames or their time stamps are exchanged",
                )
                for row in ids
                if ids[row] != ordered[row]
            ]
        return found

    def _miscounted(self) -> list[TriggerFinding]:
        found = []
        for gap in self._gaps:
            # The camera exposed on every pulse: the missing frames were lost in transfer, which is no fault of the
            # trigger.
            if gap.unanswered == 0:
                continue
            if gap.unanswered > len(gap.missing):
                text = f"its frame's id does not count the pulses since row {gap.before} {gap.span}"
                found.append(self._finding(gap.after, "miscounted", text))
            elif gap.unanswered == len(gap.missing):
                text = f"the camera did not answer its pulse {gap.span}"
                found += [self._finding(row, "ignored-trigger", text) for row in gap.missing]
            elif gap.unanswered > 0:
                rows = ", ".join(map(str, gap.missing))
                text = f"the camera did not answer {gap.unanswered} of the pulses of rows {rows} {gap.span}"
                found.append(self._finding(None, "ignored-trigger", text))
            else:
                text = f"since row {gap.before} the camera exposed {-gap.unanswered} time(s) without a pulse {gap.span}"
                found.append(self._finding(gap.after, "extra-frame", text))
        return found

    def _unassigned(self) -> list[TriggerFinding]:
        found = []
        for frame in self._extra:
            rows = [row for row, pulse in self._pulses.items() if pulse.host_s <= frame.host_s + self._bound_s]
            row = max(rows, default=None)
            since = "before the first pulse"
            if row is not None:
                since = f"{(frame.host_s - self._pulses[row].host_s) * 1e3:.1f} ms after the pulse of row {row}"
            number = f" (frame id {frame.frame_id})" if frame.frame_id is not None else ""
            nearest = min(self._pulses, key=lambda r: abs(self._pulses[r].host_s - frame.host_s), default=None)
            before_s = 0.0 if nearest is None else self._pulses[nearest].host_s - frame.host_s
            if nearest is not None and self._bound_s < before_s < GATE_S:
                since += f" and {before_s * 1e3:.1f} ms before that of row {nearest}"
            text = f"the camera exposed once without a pulse, {since}{number}: its trigger line may bounce"
            found.append(self._finding(row, "extra-frame", text))
        return found


def _latency_changed(camera: int, assigned_s: float | None, in_order_s: float) -> TriggerFinding:
    before = "no frame fits the latency that was expected"
    if assigned_s is not None:
        before = f"not {assigned_s * 1e3:.1f} ms as expected, so they are in wrong rows"
    text = f"its time stamps come {in_order_s * 1e3:.1f} ms after the pulses, one frame for each pulse: {before}"
    return TriggerFinding(camera=camera, row=None, kind="latency-changed", text=text)


def _latency_ambiguous(camera: int, assigned_s: float | None) -> TriggerFinding:
    taken = "" if assigned_s is None else f"; {assigned_s * 1e3:.1f} ms is assumed"
    text = (
        "no complete frame of the first pulse came, and no earlier run has confirmed the latency of its time stamps: "
        f"its frames may be in wrong rows{taken}"
    )
    return TriggerFinding(camera=camera, row=None, kind="latency-ambiguous", text=text)


def _unsupported(camera: int, frame: ObservedFrame, latency_s: float) -> TriggerFinding:
    text = (
        f"its frame comes {latency_s * 1e3:.1f} ms after its pulse, and no other frame of the camera shows whether "
        "this is its latency: something other than its pulse may have exposed it"
    )
    return TriggerFinding(camera=camera, row=frame.row, kind="off-beat", text=text)


def _in_order_s(
    pulses: Mapping[int, ObservedPulse],
    pulse_bound_s: float,
    assigned: Sequence[ObservedFrame],
    extra: Sequence[ObservedFrame],
) -> float | None:
    """Return the latency at which the frames follow the pulses one by one; None if they were assigned in that way."""
    rows = sorted(pulses)
    frames = sorted([*assigned, *extra], key=lambda f: f.host_s)
    # So few frames may follow some pulses in order by chance.
    if len(frames) != len(rows) or len(rows) < ENOUGH or [f.row for f in frames] == rows or not extra:
        return None
    left = residuals_s([pulses[row].event.time_s for row in rows], [f.time_s for f in frames])
    if max(abs(left)) > RESIDUAL_LIMIT_S or len({f.epoch for f in frames}) != 1:
        return None
    found_s = median([f.host_s - pulses[row].host_s for f, row in zip(frames, rows, strict=True)])
    # A frame in order is never earlier than its pulse, except by the errors of the clocks.
    return max(found_s, 0.0) if found_s >= -(pulse_bound_s + CLOCK_SLACK_S) else None


def _residuals(pulses: Mapping[int, ObservedPulse], assigned: Sequence[ObservedFrame]) -> dict[int, float]:
    found: dict[int, float] = {}
    for epoch in {f.epoch for f in assigned}:
        frames = [f for f in assigned if f.epoch == epoch and f.row is not None]
        rows = [f.row for f in frames if f.row is not None]
        left = residuals_s([pulses[row].event.time_s for row in rows], [f.time_s for f in frames])
        found |= dict(zip(rows, left.tolist(), strict=True))
    return dict(sorted(found.items()))


def _latency_s(pulses: Mapping[int, ObservedPulse], assigned: Sequence[ObservedFrame]) -> float:
    return median([f.host_s - pulses[f.row].host_s for f in assigned if f.row is not None])


ACTIONS: Mapping[Kind, str] = {
    "runs-freely": (
        "Check by vaoi doctor that the camera is in trigger mode and listens to the input to which the trigger is "
        "wired, then film the board again."
    ),
    "off-beat": "Check the camera's trigger line for interference, then film the board again.",
    "clock-jumped": (
        "Find what sets the camera's clock (a PTP master that came or went, another program) and check its power, then "
        "film the board again."
    ),
    "latency-changed": (
        "Film the board again: the latency that was found is used from now on. If it stays as it is, write it to "
        "latency_us of the camera in station.toml."
    ),
    "latency-ambiguous": (
        "Film the board again: a run with a frame of its first pulse settles it. Or write the camera's latency to "
        "latency_us of the camera in station.toml."
    ),
    "exchanged": "Film the board again; report it with the proof of the run if it returns.",
    "early": "Film the board again; report it with the proof of the run if it returns.",
    "miscounted": "Check the camera's setting of the frame id, then film the board again.",
    "other-light": (
        "Film the board again. If it returns, check the wiring of the LED channels, and the trigger line of a camera "
        "whose sequencer is a row off; with a replay, use a program that fits the recording."
    ),
    "extra-frame": "Check the trigger line for bounces and crosstalk.",
}
"""For each kind of finding that makes a run doubtful, the action. Kinds without an entry only explain missing
frames."""


def doubtful(proof: TriggerProof | None) -> tuple[TriggerFinding, ...]:
    """Return the findings that leave a doubt about the frames of a run; the others only explain missing frames."""
    return tuple(f for f in proof.findings if f.kind in ACTIONS) if proof is not None else ()


def doubts_of(proof: TriggerProof | None) -> tuple[str, ...]:
    """Return one sentence for each camera and kind of doubtful finding, for the head of the recording."""
    grouped: dict[tuple[int, Kind], list[TriggerFinding]] = {}
    for finding in doubtful(proof):
        grouped.setdefault((finding.camera, finding.kind), []).append(finding)
    return tuple(_sentence(camera, kind, found) for (camera, kind), found in grouped.items())


def _sentence(camera: int, kind: Kind, found: list[TriggerFinding]) -> str:
    rows = sorted({f.row for f in found if f.row is not None})
    where = f", row{'s' if len(rows) > 1 else ''} {', '.join(map(str, rows))}" if rows else ""
    unused = "; these frames are not used" if kind in QUESTIONING_KINDS else ""
    return f"trigger of camera {camera}{where}: {found[0].text}{unused}"
