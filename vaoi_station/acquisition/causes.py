"""Find out from the frame ids of a camera why a frame is missing, and whether two frames are exchanged.

A time stamp shows to which pulse a frame belongs. A frame id shows what was lost: a camera counts the frames that it
sends. A gap in the ids is therefore a loss in transfer, and a missing frame without a gap was never exposed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import pairwise

MAX_FRAME_ID, MAX_EXTENDED_ID = 0xFFFF, 0xFFFF_FFFF_FFFF_FFFF
"""Largest 16-bit frame id, and largest 64-bit one. GigE Vision counts 1 … largest and then 1 again; 0 never occurs."""

NO_PACKET = (
    "the camera answers, but not one packet of a frame has arrived since it was opened; check that no firewall of this "
    "computer or switch drops its UDP packets, and that its trigger line is wired"
)
"""Cause of missing frames of a camera that answers requests and never sent a frame."""


def id_step(first: int, second: int) -> int:
    """Return the number of frames from id `first` to id `second`. Ids may wrap to their start in between."""
    step = second - first
    # An id above 65535 proves 64-bit ids.
    largest = MAX_EXTENDED_ID if max(first, second) > MAX_FRAME_ID else MAX_FRAME_ID
    # Half the range separates a wrap from a step back.
    if abs(step) <= largest // 2:
        return step
    return step + largest if step < 0 else step - largest


@dataclass(frozen=True)
class Gap:
    """The interval between two frames of one camera: how many pulses were fired, and how often the camera exposed."""

    before: int
    """Row of the frame at the beginning of the gap."""
    after: int
    """Row of the frame at the end of the gap."""
    ids: tuple[int, int]
    """Frame ids of the frames at the beginning and at the end of the gap."""
    pulses: int
    """Count of pulses fired after the pulse of row `before`, up to and including the pulse of row `after`."""
    exposed: int
    """Count of frames that the camera exposed in the gap, according to its frame ids."""
    missing: tuple[int, ...]
    """Rows between `before` and `after` of which no frame arrived."""

    @property
    def unanswered(self) -> int:
        """Count of pulses in the interval on which the camera did not expose.

        A negative value counts exposures without a pulse. A value above the number of missing rows means that the
        frame ids contradict the time stamps.
        """
        return self.pulses - self.exposed

    @property
    def span(self) -> str:
        """The frame ids at both ends, and the count of pulses, as a text for causes and findings."""
        return f"(frame ids {self.ids[0]} → {self.ids[1]} over {self.pulses} pulses)"


def in_counting_order(ids: Mapping[int, int]) -> dict[int, int]:
    """Return the same rows and frame ids, with the ids assigned to the rows in ascending order: {row: id}.

    The returned ids differ from `ids` in those rows whose frames are exchanged.
    """
    rows = sorted(ids)
    if not rows:
        return {}
    first = ids[rows[0]]
    return dict(zip(rows, sorted((ids[row] for row in rows), key=lambda i: id_step(first, i)), strict=True))


def find_gaps(
    fired: Sequence[int], ids: Mapping[int, int], incomplete: AbstractSet[int], unassigned_ids: Sequence[int]
) -> list[Gap]:
    """Return, for one camera, the intervals between consecutive frames that have a frame id.

    Args:
        fired: rows whose pulse was fired, in order.
        ids: row → frame id, for the rows whose frame has one.
        incomplete: rows of which a frame without a usable id arrived.
        unassigned_ids: ids of frames that belong to no row.
    """
    # Ids are sorted first: next to an exchanged frame one interval would be negative and the other too large.
    ids = in_counting_order(ids)
    place = {row: n for n, row in enumerate(fired)}
    found = []
    for before, after in pairwise(sorted(row for row in ids if row in place)):
        step = id_step(ids[before], ids[after])
        # The camera counts unassigned frames too. If they were not subtracted, they would hide unanswered pulses.
        extra = sum(1 for i in unassigned_ids if 0 < id_step(ids[before], i) < step)
        between = fired[place[before] + 1 : place[after]]
        missing = tuple(row for row in between if row not in incomplete)
        pulses = place[after] - place[before]
        found.append(Gap(before, after, (ids[before], ids[after]), pulses, step - extra, missing))
    return found


def explain_missing(row: int, numbered: AbstractSet[int], gaps: Sequence[Gap], unassigned: int = 0) -> str:
    """Return a text that states why a row has no frame.

    Args:
        row: the missing row.
        numbered: rows of the same camera whose frame has an id.
        gaps: the intervals between the numbered rows (`find_gaps`).
        unassigned: number of frames that came during the run and belong to no row.
    """
    if not numbered:
        return (
            f"the camera sent {unassigned} frame(s) in this run, but no time stamp fits a pulse"
            if unassigned
            else "the camera sent no frame in this run; check its cable, its power and its trigger line"
        )
    gap = next((g for g in gaps if row in g.missing), None)
    if gap is None:
        return "no frame arrived for the first pulses" if row < min(numbered) else "no frame arrived after the last one"
    if gap.unanswered == 0:
        return f"lost in transfer: the camera counted it {gap.span}"
    if gap.unanswered == len(gap.missing):
        return f"the camera did not expose: its frame ids have no gap {gap.span}"
    if 0 < gap.unanswered < len(gap.missing):
        share = f"{gap.unanswered} of {len(gap.missing)} such pulses"
        return f"lost in transfer, or not exposed, as {share} were; the frame ids do not show which {gap.span}"
    return f"lost, and the frame ids do not show how {gap.span}"
