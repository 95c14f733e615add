"""Link rows again if the belt moved between them at another speed than its nominal one, or stood still.

While frames arrive, links are searched near the nominal motion, frame by frame. If the links of two consecutive rows
are too few or do not agree, the motion is searched here in the whole range that a belt can move, for all cameras
together: their reduced, high-passed frames are correlated at all shifts by Fourier transforms, and the sums are added
at the shifts that one motion on the conveyor's plane causes in each camera. Links of patches around the best candidates
then show which of them is right. A run in which the belt keeps its speed is not changed.

A repeated pattern, such as a grid of LEDs, fits at several motions, and two cameras may find different ones although
they see one motion. `possible_motions` lists them, so that all cameras together are compared at each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.steps import Steps, completed
from vaoi_station.stitching.matching.evidence import FrameKey, Links, RowsLinks, Task, by_rows
from vaoi_station.stitching.matching.frame_pair import FramePair, predict
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.link import (
    STATIC_PX,
    Small,
    best_peaks,
    link_in_place,
    link_rows,
    row_reach_mm,
    shows_patches,
    static_corners,
)

Ints = NDArray[np.int64]
Step = tuple[int, int]
"""Two consecutive rows with frames, p and q."""
FASTEST = 1.5  # largest motion between two rows that is searched, as a share of the nominal motion; the smallest is 0
_ACROSS_MM = 2.0  # largest motion across the belt between two rows that is searched
_BACK_MM = 1.0
"""Range of the search against the belt's direction, mm.

A board at rest has its highest correlation at a motion of 0, and a maximum needs neighbours on both sides."""
_LEAST_OVERLAP = 0.12  # least share of a frame that the frames of both rows must show
_MIN_CONTRAST = 1.0  # contrast, rms of the high-passed grey levels, below which a frame counts as empty
_MIN_SCORE = (
    0.12  # smallest correlation of a candidate: low, because components that lean reduce it; links decide later
)
_CANDIDATES = 5
SIMILAR = 0.75  # another motion fits as well if it has at least this share of the largest number of links
APART_MM = 0.5  # least difference between two motions: a smaller one comes from components that lean
_STATIC_BOX, _STATIC_SHARE = 5, 0.4
"""Limits for texture that stands still, which is searched in squares of `_STATIC_BOX` reduced pixels.

Texture stands still if the squared difference of two frames, summed over a square, is less than `_STATIC_SHARE` times
the sum of their squares. This ratio is 1 for unrelated texture."""
_AGREE_MM = 0.5
"""Largest distance from the median at which links of two rows agree, mm.

Turns of the board, and components that lean, displace correct links from the median."""
_CERTAIN, _SHARE = 24, 0.4
"""Number of agreeing links, and their share of the tried corners, from which on a motion is certain."""
_FEW, _MOST = 8, 0.6
"""The same where an overlap has few corners: at least `_FEW` links, and at least the share `_MOST` of the corners.

Links near the nominal motion need no search if they reach this number and share. Pins of components and other periodic
texture reached a share of 0.3 at a wrong motion (`_BY_CHANCE`); the correct motion reached 0.9."""
_BY_CHANCE = 0.3
_BETTER = 2.0  # least ratio of the agreeing links around a new motion to those around the nominal motion
_REST_MM = 1.0  # the board counts as at rest at a motion up to this; texture that stands still is then removed
_NEAR_PX, _CONTINUES = 4.0, 0.2
"""Limits by which texture at rest is recognised as the board's, because the board moves on later.

A patch continues if it appears within `_NEAR_PX` px of its place after the motion of the next row. At least the share
`_CONTINUES` of the patches must do so."""


def candidate_motions(pairs: Sequence[FramePair], *, moving: bool = False) -> Steps[list[Floats]]:
    """Return motions (2,) in mm of the board from rows p to q that fit their pictures, the most likely first.

    Yield after each camera.

    Args:
        pairs: the frames of rows p and q of each camera; `shift_mm` is the nominal motion, which gives direction and
            range.
        moving: whether to leave out texture that both frames show in the same place. Otherwise, texture that stands
            still beside the board may outweigh the board.
    """
    copies = [(pair, *(_moving(pair) if moving else (pair.a.coarse, pair.b.coarse))) for pair in pairs]
    textured = [one for one in copies if min(float(np.sqrt(np.mean(x * x))) for x in one[1:]) >= _MIN_CONTRAST]
    way = float(np.hypot(*textured[0][0].shift_mm)) if textured else 0.0
    if way <= 0:
        return []
    along = np.asarray(textured[0][0].shift_mm) / way
    across = np.array([-along[1], along[0]])
    cell = max(pair.a.factor / pair.camera_a.px_per_mm for pair, *_ in textured)
    # A whole number of samples, so that a motion of exactly 0 is one of them.
    u = np.arange(-math.ceil(_BACK_MM / cell) - 1, math.ceil(FASTEST * way / cell) + 2) * cell
    v = np.arange(-math.ceil(_ACROSS_MM / cell), math.ceil(_ACROSS_MM / cell) + 1) * cell
    motion = u[None, :, None] * along + v[:, None, None] * across
    sums = np.zeros((4, len(v), len(u)))
    for pair, a, b in textured:
        sums += _correlated(a, b, _shifts(pair, motion))
        yield
    products, energy_a, energy_b, overlap = sums
    energy = np.sqrt(np.maximum(energy_a * energy_b, 0.0))
    whole = max(float(energy.max()), 1e-9)
    # At shifts at which the frames have hardly any texture in common, the correlation of noise is large.
    known = (overlap >= _LEAST_OVERLAP * len(textured)) & (energy > 0.02 * whole)
    score = np.where(known, products / np.maximum(energy, 1e-9 * whole), 0.0).astype(np.float32)
    peaks = best_peaks(np.ascontiguousarray(score), _CANDIDATES).tolist()
    return [(u[0] + x * cell) * along + (v[0] + y * cell) * across for s, x, y in peaks if s >= _MIN_SCORE]


def _moving(pair: FramePair) -> tuple[Small, Small]:
    """Return the reduced copies of both frames of a pair, with 0 where both show the same texture."""
    a, b = pair.a.coarse, pair.b.coarse
    apart, both = (cv2.boxFilter(x, -1, (_STATIC_BOX, _STATIC_BOX)) for x in ((a - b) ** 2, a * a + b * b))
    moves = apart > _STATIC_SHARE * both
    return a * moves, b * moves


def _correlated(a: Small, b: Small, shift: Ints) -> Floats:
    """Correlate two reduced frames at shifts (..., 2) from a to b, px, by Fourier transforms with zeros beside them.

    Return four sums over the common pixels at each shift, (4, ...): of products, of squares of a and of b, and of ones,
    as a share of the frame.
    """
    (height, width), (rows, columns) = a.shape, b.shape
    # Half a frame of zeros would do for most shifts; a whole frame is enough for all of them. Single precision errs by
    # 1e-7 of the highest value.
    size = cv2.getOptimalDFTSize(height + rows), cv2.getOptimalDFTSize(width + columns)
    padded = [np.pad(x, ((0, size[0] - len(x)), (0, size[1] - x.shape[1]))) for x in (a, b)]
    spectrum_a, spectrum_b = (cv2.dft(x, nonzeroRows=n) for x, n in zip(padded, (height, rows), strict=True))
    product = cv2.mulSpectrums(spectrum_b, spectrum_a, 0, conjB=True)
    products = cv2.dft(product, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
    x, y = shift[..., 0], shift[..., 1]
    # What is common is a rectangle in each frame: sums over it need no transform.
    left, top = np.clip(-x, 0, width), np.clip(-y, 0, height)
    right, bottom = np.clip(columns - x, left, width), np.clip(rows - y, top, height)
    common = (right - left) * (bottom - top)
    energy_a = _sum_within(a, left, top, right, bottom)
    energy_b = _sum_within(b, left + x, top + y, right + x, bottom + y)
    sums = np.array([products[y % size[0], x % size[1]], energy_a, energy_b, common / a.size])
    return np.where(common > 0, sums, 0.0)


def _sum_within(picture: Small, left: Ints, top: Ints, right: Ints, bottom: Ints) -> Floats:
    """Return the sums of squares of a picture in rectangles (...), whose right and lower ends are excluded."""
    sums = cv2.integral(picture * picture, sdepth=cv2.CV_64F)
    height, width = picture.shape
    (x0, x1), (y0, y1) = (np.clip(v, 0, width) for v in (left, right)), (np.clip(v, 0, height) for v in (top, bottom))
    return np.asarray(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0])


def _shifts(pair: FramePair, motion: Floats) -> Ints:
    """Convert motions (..., 2) of the board, mm, to the shifts of the reduced picture that they cause at its centre."""
    centre = np.array([pair.camera_a.center_px])
    # The shift of the picture is linear in the motion, except for a reduced pixel or two.
    still, *moved = (predict(centre, pair.camera_a, pair.camera_b, e)[0] for e in (np.zeros(2), *np.eye(2)))
    shift = np.rint((motion @ (np.array(moved) - still) + (still - centre[0])) / pair.a.factor)
    return np.asarray(shift, dtype=np.int64)


def possible_motions(links: Sequence[Links], cameras: Sequence[Camera], nominal_mm: Floats) -> list[Floats]:
    """Return the motions (2,) between two rows that one of the cameras allows, within the range of the coarse search.

    Args:
        links: the links between the two rows, one entry per camera.
        nominal_mm: (2,) nominal motion between the two rows.
    """
    found: list[Floats] = []
    for e in links:
        if not len(e.a_px):
            continue
        camera = cameras[e.task.a[0]]
        own = np.median(camera.ground(e.b_px) - camera.ground(e.a_px), axis=0)
        found.append(own)
        if e.rival_px is not None and e.coarse_px is not None:
            middle = e.b_px.mean(axis=0)
            spacing = camera.ground(middle + np.subtract(e.rival_px, e.coarse_px)) - camera.ground(middle)
            found += [own + spacing, own - spacing]
    reach = row_reach_mm(nominal_mm) + APART_MM
    near = [motion for motion in found if (np.abs(motion - nominal_mm) <= reach).all()]
    return [one for n, one in enumerate(near) if all(np.hypot(*(one - other)) > APART_MM for other in near[:n])]


@dataclass(frozen=True, eq=False)
class _Found:
    """A motion between two rows that was tried, with the links of all cameras found near it."""

    motion_mm: Floats
    links: tuple[Links, ...]
    agreeing: int
    ambiguous: bool = False  # whether another motion fits as well because of a repeated pattern
    repeated: bool = False  # whether a camera sees a repeated pattern, so that its coarse search is no evidence
    still: int = 0  # number of the tried corners that both rows show in the same place

    @property
    def certain(self) -> bool:
        """Whether the share of agreeing links is so large that false links to similar texture cannot explain it."""
        n, tried = self.agreeing, max(sum(e.tried for e in self.links) - self.still, self.agreeing)
        return (n >= _CERTAIN and n >= _SHARE * tried) or (n >= _FEW and n >= _MOST * tried)

    @property
    def at_rest(self) -> bool:
        return float(np.hypot(*self.motion_mm)) < _REST_MM


class _Decision(NamedTuple):
    """What the links of two consecutive rows near the nominal motion, and further searches, show of their step."""

    step_mm: Floats  # (2,) motion by the links near the nominal one, or the nominal one itself
    found: list[_Found]  # other motions that links confirm, the most likely first

    @property
    def motion_mm(self) -> Floats:
        return self.found[0].motion_mm if self.found else self.step_mm


class Relinker:
    """Links the rows of a run again where the motion differs from the nominal one.

    Each decision depends on the links and frames of two rows only. It is made once, in the conclusion of the run or as
    soon as these links are complete, and is the same in both cases.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        velocity_mm_s: Floats,
        prepared: Callable[[FrameKey], PreparedFrame],
        motions_mm: Callable[[tuple[Links, ...]], tuple[Floats, Ints]],
    ) -> None:
        """Create the relinker of one run.

        Args:
            cameras: the cameras of the run.
            velocity_mm_s: (2,) nominal velocity of the belt.
            prepared: returns a frame of the run.
            motions_mm: returns the motions (k, 2) on the conveyor's plane that links of two rows measure, and numbers
                (k,) of their pairs of frames, from 0 on.
        """
        self._cameras, self._velocity_mm_s = cameras, np.asarray(velocity_mm_s, dtype=np.float64)
        self._prepared, self._motions_mm = prepared, motions_mm
        self._decided: dict[Step, tuple[tuple[object, ...], _Decision]] = {}
        self._again: dict[Links, tuple[tuple[float, ...], Links]] = {}
        self._spans: list[tuple[Links, ...]] = []

    def prepare(self, links: tuple[Links, ...]) -> Steps[list[tuple[Links, ...]]]:
        """Do early what `relinked` will need of the links of two rows, in which all cameras delivered their frames.

        Return the links that are most likely used, of these rows and of others that were waiting for them.
        """
        (p, q), out = links[0].rows, list[tuple[Links, ...]]()
        if q - p > 1:
            self._spans.append(links)
        else:
            cameras = tuple(e.task.a[0] for e in links)
            decision = yield from self._decide((p, q), cameras, links, links[0].task.dt_s)
            out.append(decision.found[0].links if decision.found else links)
        for span in tuple(self._spans):
            p, q = span[0].rows
            within = [self._decided[r, r + 1][1] for r in range(p, q) if (r, r + 1) in self._decided]
            if len(within) == q - p:
                self._spans.remove(span)
                out.append(tuple((yield from self._along(span, within))) or span)
        return out

    def relinked(self, links: RowsLinks, present: Collection[FrameKey], times_s: Floats) -> RowsLinks:
        """Return the links of a run, searched again between rows where the motion is not the nominal one.

        `links` are all links of the run near the nominal motion; those between cameras are not changed.
        """
        of_row: dict[int, set[int]] = {}
        for camera, row in present:
            of_row.setdefault(row, set()).add(camera)
        decided = dict[Step, _Decision]()
        for p, q in pairwise(sorted(of_row)):
            dt_s, both = round(float(times_s[q] - times_s[p]), 6), tuple(sorted(of_row[p] & of_row[q]))
            decided[p, q] = completed(self._decide((p, q), both, links.get((p, q), ()), dt_s))
        found = {step: one.found[0] for step, one in decided.items() if one.found}
        if found:
            self._exclude_static(decided, found, present)
        if not found:
            return links
        new = {e.task[:3]: e for one in found.values() for e in one.links}
        for (p, q), each in links.items():
            within = [step for step in decided if p <= step[0] and step[1] <= q]
            if len(within) > 1 and any(step in found for step in within):
                chosen = [decided[s]._replace(found=[found[s]] if s in found else []) for s in within]
                new |= {e.task[:3]: e for e in completed(self._along(each, chosen))}
        kept = (e for each in links.values() for e in each if e.task[:3] not in new)
        return by_rows((*kept, *new.values()))

    def _along(self, links: Sequence[Links], steps: Sequence[_Decision]) -> Steps[list[Links]]:
        """Search the links of two rows with others between them at the motion of these steps, if one is not nominal."""
        out = []
        # With a repeated pattern, a coarse search would find another place again.
        repeated = any(one.found and one.found[0].repeated for one in steps)
        motion_mm = np.sum([one.motion_mm for one in steps], axis=0)
        key = *motion_mm.tolist(), float(repeated)
        for e in links if any(one.found for one in steps) else ():
            known = self._again.get(e)
            if known is None or known[0] != key:
                pair = self._pair(e.task.a, e.task.b or e.task.a, motion_mm)
                known = self._again[e] = key, (link_in_place if repeated else link_rows)(e.task, pair)
                yield
            out.append(known[1])
        return out

    def _decide(self, step: Step, cameras: tuple[int, ...], links: tuple[Links, ...], dt_s: float) -> Steps[_Decision]:
        """Decide at which motions the rows of a step are linked.

        `cameras` are those that show both rows, and `links` those near the nominal motion in the time `dt_s`.
        """
        key = cameras, links, dt_s
        if step in self._decided and self._decided[step][0] == key:
            return self._decided[step][1]
        nominal, found = self._velocity_mm_s * dt_s, list[_Found]()
        motions, group = self._motions_mm(links) if links else (np.zeros((0, 2)), np.zeros(0, np.int_))
        middle = np.median(motions, axis=0) if len(motions) else nominal
        near = np.hypot(*(motions - middle).T) <= _AGREE_MM
        agreeing, tasks = int(near.sum()), tuple(Task("rows", (i, step[0]), (i, step[1]), dt_s) for i in cameras)
        settled = None
        if any(e.rival_px is not None for e in links) and not _outvoted(links, near, group):
            settled = yield from self._settle(tasks, links, nominal)
        if settled is not None and settled.certain:
            found = [settled]
        elif agreeing < max(_FEW, _MOST * sum(e.tried for e in links)):
            found = yield from self._search(tasks, nominal, agreeing)
        decision = _Decision(middle if agreeing else nominal, found)
        self._decided[step] = key, decision
        return decision

    def _pairs(self, tasks: Sequence[Task], motion_mm: Floats) -> list[tuple[Task, FramePair]]:
        return [(task, self._pair(task.a, task.b or task.a, motion_mm)) for task in tasks]

    def _pair(self, a: FrameKey, b: FrameKey, motion_mm: Floats) -> FramePair:
        """Return two frames of one camera between which the board moved by this."""
        camera = self._cameras[a[0]]
        return FramePair(self._prepared(a), self._prepared(b), camera, camera, motion_mm)

    def _counted(self, motion_mm: Floats, links: tuple[Links, ...]) -> _Found:
        """Return the motion that links measure (their median), with the count of links that agree with it.

        Without links it is the motion that was tried, `motion_mm` (2,).
        """
        cameras = self._cameras
        each = [cameras[e.task.a[0]].ground(e.b_px) - cameras[e.task.a[0]].ground(e.a_px) for e in links if len(e.a_px)]
        if not each:
            return _Found(motion_mm, links, 0)
        measured = np.concatenate(each)
        return _Found(np.median(measured, axis=0), links, _agreeing(measured))

    def _linked(
        self, tasks: Sequence[Task], motion_mm: Floats, link: Callable[[Task, FramePair], Links] = link_in_place
    ) -> Steps[_Found]:
        """Link two rows around a motion, camera by camera."""
        out = []
        for task in tasks:
            out.append(link(task, self._pair(task.a, task.b or task.a, motion_mm)))
            yield
        return self._counted(motion_mm, tuple(out))

    def _settle(self, tasks: Sequence[Task], links: Sequence[Links], nominal_mm: Floats) -> Steps[_Found | None]:
        """Return the links of two rows around the most likely motion among those that a repeated pattern allows.

        It is the motion nearest to the nominal one among those with similarly many links. Return None if only one
        motion fits and all cameras have found it.
        """
        options = list[_Found]()
        for motion in possible_motions(links, self._cameras, nominal_mm):
            options.append((yield from self._linked(tasks, motion)))
        most = max((one.agreeing for one in options), default=0)
        if not most:
            return None
        fitting = [one for one in options if one.agreeing >= SIMILAR * most]
        nearest = min(fitting, key=lambda one: _distance(one.motion_mm, nominal_mm))
        if any(_distance(one.motion_mm, nearest.motion_mm) > APART_MM for one in fitting):
            marked = tuple(replace(e, ambiguous=True) for e in nearest.links)
            return replace(nearest, links=marked, ambiguous=True, repeated=True)
        known = self._counted(nominal_mm, tuple(links))
        if known.agreeing >= nearest.agreeing and _distance(known.motion_mm, nearest.motion_mm) <= APART_MM:
            return None
        return replace(nearest, repeated=True)

    def _search(self, tasks: Sequence[Task], nominal_mm: Floats, before: int) -> Steps[list[_Found]]:
        """Search the motion of a step in its whole range; return those that links confirm, most links first.

        `before` is the number of agreeing links around the nominal motion.
        """
        frames, found = [pair for _, pair in self._pairs(tasks, nominal_mm)], list[_Found]()
        for motion in (yield from candidate_motions(frames)):
            found.append((yield from self._linked(tasks, motion, link_rows)))
        found = [one for one in found if one.certain and one.agreeing >= _BETTER * before]
        if any(one.at_rest for one in found):
            # Texture that stands still may belong to the belt or its frame. It may outweigh a board that moves. A
            # separate search for each camera would find the texture that stands still.
            for motion in (yield from candidate_motions(frames, moving=True)):
                still = sum(static_corners(pair) for _, pair in self._pairs(tasks, motion))
                one = replace((yield from self._linked(tasks, motion)), still=still)
                if one.certain and not one.at_rest and one.agreeing >= _BETTER * before:
                    found.append(one)
        return sorted(found, key=lambda one: -one.agreeing)

    def _exclude_static(
        self, decided: Mapping[Step, _Decision], found: dict[Step, _Found], present: Collection[FrameKey]
    ) -> None:
        """Remove links of texture that stands still from rows at rest; the others decide whether the board rests.

        The belt's frame, a bed with texture, and reflections of the LEDs are at the same place in every row. The
        texture of a board moves on before or after the rest. A board that rests from the first row to the last cannot
        be distinguished from them: its texture is taken as that of a board, unless something else in these rows moves.
        """
        steps, rests = list(decided), list[list[int]]()
        for n, step in enumerate(steps):
            if step in found and found[step].at_rest:
                if rests and rests[-1][-1] == n - 1:
                    rests[-1].append(n)
                else:
                    rests.append([n])
        for group in rests:
            before, after = steps[max(group[0] - 1, 0) : group[0]], steps[group[-1] + 1 : group[-1] + 2]
            outside = [*(p for p, _ in before), *(q for _, q in after)]
            others = {n: [one for one in decided[steps[n]].found if not one.at_rest] for n in group}
            continues = self._continues(steps[group[0]], steps[group[-1]], (before, after), decided, present)
            if continues is None and not outside:
                continues = not any(others.values())
            for n in group:
                moving = self._without_static(found[steps[n]], outside, present)
                if moving.certain and continues is not False:
                    found[steps[n]] = moving
                elif others[n]:
                    found[steps[n]] = others[n][0]
                else:
                    del found[steps[n]]

    def _continues(
        self,
        first: Step,
        last: Step,
        beside: tuple[list[Step], list[Step]],
        decided: Mapping[Step, _Decision],
        present: Collection[FrameKey],
    ) -> bool | None:
        """Return whether texture at rest moves on before or after the rest, as the texture of a board does.

        Texture of the belt's frame does not move; meanwhile the board may cover it. Return None if too little of it is
        in view.
        """
        tested = shown = 0
        for at, (step, way) in enumerate(zip((first, last), beside, strict=True)):
            for moved in way:
                row, other = step[at], moved[at]
                motion = decided[moved].step_mm if at else -decided[moved].step_mm
                if float(np.hypot(*motion)) < _REST_MM:
                    continue
                both = [i for i in range(len(self._cameras)) if {(i, step[0]), (i, step[1])} <= set(present)]
                for i in both:
                    task = Task("rows", (i, step[0]), (i, step[1]))
                    links = link_in_place(task, self._pair((i, step[0]), (i, step[1]), np.zeros(2)))
                    px = links.b_px if at else links.a_px
                    if len(px) and (i, other) in present:
                        on = self._pair((i, row), (i, other), motion)
                        shows, inside = shows_patches(on.a.grey, on.b.grey, px, on.predict(px), _NEAR_PX)
                        shown, tested = shown + int(shows.sum()), tested + int(inside.sum())
        return None if tested < _FEW else shown >= max(_FEW / 2, _CONTINUES * tested)

    def _without_static(self, one: _Found, outside: Sequence[int], present: Collection[FrameKey]) -> _Found:
        """Remove links of texture that has the same place in a row of `outside`: such texture is not on the board."""
        kept = []
        for e in one.links:
            moving = np.ones(len(e.a_px), dtype=np.bool_)
            a = self._prepared(e.task.a).grey
            for row in outside:
                if (e.task.a[0], row) in present and len(e.a_px):
                    other = self._prepared((e.task.a[0], row)).grey
                    moving &= ~shows_patches(a, other, e.a_px, e.a_px, STATIC_PX)[0]
            kept.append(_selected(e, moving))
        return self._counted(one.motion_mm, tuple(kept))


def _outvoted(links: Sequence[Links], near: NDArray[np.bool_], group: Ints) -> bool:
    """Return whether all cameras found one motion, and those that see a pattern cannot make another as likely.

    `near` (k,) are the links that agree with the median of all, `group` (k,) the numbers of their cameras. Cameras
    without a rival have few links at other motions.
    """
    if (2 * np.bincount(group[near], minlength=int(group.max(initial=-1)) + 1) <= np.bincount(group)).any():
        return False
    return sum(e.tried * (_BY_CHANCE if e.rival_px is None else 1.0) for e in links) < SIMILAR * int(near.sum())


def _agreeing(motion_mm: Floats) -> int:
    """Return how many of the motions (k, 2) agree with their median."""
    if not len(motion_mm):
        return 0
    return int((np.hypot(*(motion_mm - np.median(motion_mm, axis=0)).T) <= _AGREE_MM).sum())


def _distance(a_mm: Floats, b_mm: Floats) -> float:
    return float(np.hypot(*(a_mm - b_mm)))


def _selected(e: Links, keep: np.ndarray) -> Links:
    """Return the links of a pair of frames where `keep` (k,) is True."""
    if keep.all():
        return e
    if not keep.any():
        return Links.empty(e.task, "the texture does not move with the board", e.tried)
    tried = e.tried - int((~keep).sum())
    return Links(e.task, e.a_px[keep], e.b_px[keep], e.information[keep], e.score[keep], e.note, e.coarse_px, tried)
