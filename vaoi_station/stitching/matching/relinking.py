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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frame_pair import FramePair, predict
from vaoi_station.stitching.matching.frames import Scene
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
texture reached a share of 0.3 at a wrong motion; the correct motion reached 0.9."""
_BETTER = 2.0  # least ratio of the agreeing links around a new motion to those around the nominal motion
_REST_MM = 1.0  # the board counts as at rest at a motion up to this; texture that stands still is then removed
_NEAR_PX, _CONTINUES = 4.0, 0.2
"""Limits by which texture at rest is recognised as the board's, because the board moves on later.

A patch continues if it appears within `_NEAR_PX` px of its place after the motion of the next row. At least the share
`_CONTINUES` of the patches must do so."""


def candidate_motions(pairs: Sequence[FramePair], *, moving: bool = False) -> list[Floats]:
    """Return motions (2,) in mm of the board from rows p to q that fit their pictures, the most likely first.

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
    sums = np.sum([_correlated(a, b, _shifts(pair, motion)) for pair, a, b in textured], axis=0)
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


class RowLinks(NamedTuple):
    """The k links between rows near the nominal motion: their rows, and the motion that each of them measures."""

    p: np.ndarray  # (k,) row of the first frame
    q: np.ndarray  # (k,) row of the second frame
    motion_mm: Floats  # (k, 2) motion of the board from row p to row q on the conveyor's plane


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


@dataclass(frozen=True, eq=False)
class _Relinker:
    """The frames of a run, and the motion between its rows as far as it is known."""

    scene: Scene
    velocity_mm_s: Floats
    times_s: Floats
    step_mm: dict[Step, Floats] = field(default_factory=dict)
    """Motion between consecutive rows with frames: the one found, else that of links near the nominal motion, else the
    nominal one."""

    @property
    def rows(self) -> list[int]:
        return sorted({row for _, row in self.scene.present})

    def nominal(self, p: int, q: int) -> Floats:
        return np.asarray(self.velocity_mm_s * (self.times_s[q] - self.times_s[p]))

    def pairs(self, p: int, q: int, motion_mm: Floats) -> list[tuple[Task, FramePair]]:
        """Return the tasks that link rows p and q, camera by camera, with their frames."""
        dt_s = round(float(self.times_s[q] - self.times_s[p]), 6)
        present = set(self.scene.present)
        there = [i for i in range(len(self.scene.cameras)) if {(i, p), (i, q)} <= present]
        return [(Task("rows", (i, p), (i, q), dt_s), self.pair((i, p), (i, q), motion_mm)) for i in there]

    def pair(self, a: tuple[int, int], b: tuple[int, int], motion_mm: Floats) -> FramePair:
        """Return two frames of one camera between which the board moved by this."""
        camera = self.scene.cameras[a[0]]
        return FramePair(self.scene.prepared(a), self.scene.prepared(b), camera, camera, motion_mm)

    def counted(self, motion_mm: Floats, links: tuple[Links, ...]) -> _Found:
        """Return the motion that links measure (their median), with the count of links that agree with it.

        Without links it is the motion that was tried, `motion_mm` (2,).
        """
        cameras = self.scene.cameras
        each = [cameras[e.task.a[0]].ground(e.b_px) - cameras[e.task.a[0]].ground(e.a_px) for e in links if len(e.a_px)]
        if not each:
            return _Found(motion_mm, links, 0)
        measured = np.concatenate(each)
        return _Found(np.median(measured, axis=0), links, _agreeing(measured))

    def settle(self, links: Sequence[Links], p: int, q: int) -> _Found | None:
        """Return the links of rows p and q around the most likely motion among those that a repeated pattern allows.

        It is the motion nearest to the nominal one among those with similarly many links. Return None if only one
        motion fits and all cameras have found it.
        """
        nominal, options = self.nominal(p, q), list[_Found]()
        for motion in possible_motions(links, self.scene.cameras, nominal):
            exact = tuple(link_in_place(task, pair) for task, pair in self.pairs(p, q, motion))
            options.append(self.counted(motion, exact))
        most = max((one.agreeing for one in options), default=0)
        if not most:
            return None
        fitting = [one for one in options if one.agreeing >= SIMILAR * most]
        nearest = min(fitting, key=lambda one: _distance(one.motion_mm, nominal))
        if any(_distance(one.motion_mm, nearest.motion_mm) > APART_MM for one in fitting):
            marked = tuple(replace(e, ambiguous=True) for e in nearest.links)
            return replace(nearest, links=marked, ambiguous=True, repeated=True)
        known = self.counted(nominal, tuple(links))
        if known.agreeing >= nearest.agreeing and _distance(known.motion_mm, nearest.motion_mm) <= APART_MM:
            return None
        return replace(nearest, repeated=True)

    def search(self, p: int, q: int, before: int) -> list[_Found]:
        """Search the motion from row p to row q in its whole range; return those that links confirm, most links first.

        `before` is the number of agreeing links around the nominal motion.
        """
        frames = [pair for _, pair in self.pairs(p, q, self.nominal(p, q))]
        found = []
        for motion in candidate_motions(frames):
            found.append(self.counted(motion, tuple(link_rows(*both) for both in self.pairs(p, q, motion))))
        found = [one for one in found if one.certain and one.agreeing >= _BETTER * before]
        if any(one.at_rest for one in found):
            # Texture that stands still may belong to the belt or its frame. It may outweigh a board that moves. A
            # separate search for each camera would find the texture that stands still.
            for motion in candidate_motions(frames, moving=True):
                here = self.pairs(p, q, motion)
                still = sum(static_corners(pair) for _, pair in here)
                one = replace(self.counted(motion, tuple(link_in_place(*both) for both in here)), still=still)
                if one.certain and not one.at_rest and one.agreeing >= _BETTER * before:
                    found.append(one)
        return sorted(found, key=lambda one: -one.agreeing)

    def continues(self, group: Sequence[Step]) -> bool | None:
        """Return whether texture at rest moves on before or after the rest, as the texture of a board does.

        Texture of the belt's frame does not move; meanwhile the board may cover it. Return None if too little of it is
        in view.
        """
        rows, present = self.rows, set(self.scene.present)
        first, last = rows.index(group[0][0]), rows.index(group[-1][1])
        tested = shown = 0
        for at, to in ((first, first - 1), (last, last + 1)):
            if not 0 <= to < len(rows):
                continue
            row, other = rows[at], rows[to]
            motion = -self.step_mm[other, row] if to < at else self.step_mm[row, other]
            if float(np.hypot(*motion)) < _REST_MM:
                continue
            step = (row, rows[at + 1]) if to < at else (rows[at - 1], row)
            for task, pair in self.pairs(*step, np.zeros(2)):
                links, i = link_in_place(task, pair), task.a[0]
                px = links.a_px if to < at else links.b_px
                if len(px) and (i, other) in present:
                    on = self.pair((i, row), (i, other), motion)
                    shows, inside = shows_patches(on.a.grey, on.b.grey, px, on.predict(px), _NEAR_PX)
                    shown, tested = shown + int(shows.sum()), tested + int(inside.sum())
        return None if tested < _FEW else shown >= max(_FEW / 2, _CONTINUES * tested)

    def without_static(self, one: _Found, outside: Sequence[int]) -> _Found:
        """Remove links of texture that has the same place in a row of `outside`: such texture is not on the board."""
        present, kept = set(self.scene.present), []
        for e in one.links:
            moving = np.ones(len(e.a_px), dtype=np.bool_)
            a = self.scene.prepared(e.task.a).grey
            for row in outside:
                if (e.task.a[0], row) in present and len(e.a_px):
                    other = self.scene.prepared((e.task.a[0], row)).grey
                    moving &= ~shows_patches(a, other, e.a_px, e.a_px, STATIC_PX)[0]
            kept.append(_selected(e, moving))
        return self.counted(one.motion_mm, tuple(kept))


def relink_rows(
    links: Sequence[Links], measured: RowLinks, scene: Scene, velocity_mm_s: Floats, times_s: Floats
) -> tuple[Links, ...]:
    """Return the links of a run, searched again between rows between which the motion differs from the nominal one.

    Args:
        links: all links of the run near the nominal motion, sorted by task; those between cameras are not changed.
        measured: the same links between rows, as motions on the conveyor's plane.
    """
    run = _Relinker(scene, velocity_mm_s, times_s)
    found = _find_steps(run, links, measured)
    if not found:
        return tuple(links)
    new = {e.task[:3]: e for one in found.values() for e in one.links}
    for e in links:
        if e.task.kind == "rows" and e.task[:3] not in new and e.task.b is not None:
            steps = [(p, q) for p, q in pairwise(run.rows) if e.task.a[1] <= p and q <= e.task.b[1]]
            if any(step in found for step in steps):
                pair = run.pair(e.task.a, e.task.b, np.sum([run.step_mm[step] for step in steps], axis=0))
                # With a repeated pattern, a coarse search would find another place again.
                repeated = any(step in found and found[step].repeated for step in steps)
                new[e.task[:3]] = (link_in_place if repeated else link_rows)(e.task, pair)
    kept = [e for e in links if e.task[:3] not in new]
    return tuple(sorted((*kept, *new.values()), key=lambda e: (e.task.a, e.task.b or (-1, -1), e.task.kind)))


def _find_steps(run: _Relinker, links: Sequence[Links], measured: RowLinks) -> dict[Step, _Found]:
    """Find the steps whose motion was not the nominal one, with the motion and its links.

    The motion of all steps is written to `run.step_mm`.
    """
    candidates: dict[Step, list[_Found]] = {}
    settled: dict[Step, _Found] = {}
    of_step: dict[Step, list[Links]] = {}
    for e in links:
        if e.task.kind == "rows" and e.task.b is not None:
            of_step.setdefault((e.task.a[1], e.task.b[1]), []).append(e)
    for p, q in pairwise(run.rows):
        between = of_step.get((p, q), [])
        motions = measured.motion_mm[(measured.p == p) & (measured.q == q)]
        agreeing = _agreeing(motions)
        run.step_mm[p, q] = np.median(motions, axis=0) if agreeing else run.nominal(p, q)
        one = run.settle(between, p, q) if any(e.rival_px is not None for e in between) else None
        if one is not None and one.certain:
            settled[p, q] = one
        elif agreeing < max(_FEW, _MOST * sum(e.tried for e in between)):
            candidates[p, q] = run.search(p, q, agreeing)
    found = settled | {step: each[0] for step, each in candidates.items() if each}
    rests: list[list[Step]] = []
    for step in (step for step in pairwise(run.rows) if step in found and found[step].at_rest):
        if rests and rests[-1][-1][1] == step[0]:
            rests[-1].append(step)
        else:
            rests.append([step])
    for group in rests:
        _exclude_static(run, group, found, candidates)
    run.step_mm.update({step: one.motion_mm for step, one in found.items()})
    return found


def _exclude_static(
    run: _Relinker, group: Sequence[Step], found: dict[Step, _Found], candidates: Mapping[Step, list[_Found]]
) -> None:
    """Remove links of texture that stands still from rows at rest; the remaining links decide whether the board rests.

    The belt's frame, a bed with texture, and reflections of the LEDs are at the same place in every row. The texture of
    a board moves on before or after the rest. A board that rests from the first row to the last cannot be distinguished
    from them: its texture is taken as that of a board, unless something else in these rows moves.
    """
    rows = run.rows
    first, last = rows.index(group[0][0]), rows.index(group[-1][1])
    outside = [*rows[max(first - 1, 0) : first], *rows[last + 1 : last + 2]]
    continues = run.continues(group)
    if continues is None and not outside:
        continues = not any(not one.at_rest for step in group for one in candidates.get(step, ()))
    for step in group:
        moving = run.without_static(found[step], outside)
        others = [one for one in candidates.get(step, ()) if not one.at_rest]
        if moving.certain and continues is not False:
            found[step] = moving
        elif others:
            found[step] = others[0]
        else:
            del found[step]


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
