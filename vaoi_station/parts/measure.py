"""Measures of the parts of one run: presence, place, turn, orientation and likeness to good boards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Component, RecordingHead, Stitch
from vaoi_station.parts.models import VISIBLE, Kind, Models
from vaoi_station.parts.patches import RunPatches, ViewClass, cut_patches, kind_of, view_classes
from vaoi_station.parts.registration import Fit, Floats, Floats32, Template
from vaoi_station.parts.search import search

_UNLIKE = 3.0
"""How unlike good ones a part may look that is as usual."""
_MOST_DIMMER = 3.0
"""Largest factor by which the contrast of a run's good parts differs from that of good boards: lamps become dimmer."""
_ODD, _NEAR_MM = 10.0, 0.12
"""How unlike a part must look to be searched and compared with other kinds.

Less suffices for one that lies this far from its place."""
_FITS, _BETTER = 25.0, 0.4
"""How unlike a part may look where it was found by searching, also as a share of how unlike it looks on its place."""
_LOWER = 0.5
"""How much lower, as a share of the expected height, a part must not lie where it was found by searching.

One of which the body alone is compared must lie higher than this there."""
_MOST_KINDS, _SIMILAR_MM, _MOST_EXCHANGED = 8, 1.0, 120
"""Largest number of other kinds with which a part is compared, difference of their sizes, and number of such parts."""
_MOST_SEARCHED = 400
"""Largest number of parts that are searched in one run; of a board of another type, all would be."""
_TURNED = 0.6
"""Misfit of a part with the template turned, as a share of that upright, from which on it counts as turned."""
_MOST_PLANES, _SIGNIFICANT = 4, 2.0
"""Number of times that a height is measured anew on its plane, and σ by which it must lie off it."""
_LEAST_HEIGHT_MM = 0.05
"""Parts that are expected to be flatter have no height by parallax."""


Gains = dict[tuple[str, int], float]
"""Contrast of the good parts of a run, as a share of that on good boards, by kind and class."""


class Run(NamedTuple):
    """A stitched run, as far as its parts need it."""

    board_type: BoardType
    stitch: Stitch
    cameras: Sequence[Camera]
    head: RecordingHead
    frame: Callable[[int, int], NDArray[Any] | None]

    def cut(self, parts: Sequence[Component], **how: Any) -> RunPatches:
        """Cut the patches of parts; see `cut_patches`."""
        return cut_patches(self.board_type, (self.stitch, self.cameras, self.head), self.frame, parts, **how)

    def cut_on_tops(self, parts: Sequence[Component], heights_mm: Mapping[str, float]) -> RunPatches:
        """Cut the patches of parts of a good board on the planes on which those of later boards are compared.

        Of parts whose height neither the CAD data nor other good boards (`heights_mm`) state, that is the one at which
        the frames agree: their parallax shows it from near by only, so that it is measured again there.
        """
        known = dict(heights_mm)
        for _ in range(_MOST_PLANES):
            patches = self.cut(parts, heights_mm=known)
            found = {}
            for k, part in enumerate(parts):
                above, sigma = float(patches.above_mm[k]), float(patches.above_sigma_mm[k])
                top = float(patches.height_mm[k]) + above
                stated = part.body_height is not None or part.address in heights_mm
                if not stated and abs(above) > max(_SIGNIFICANT * sigma, _LEAST_HEIGHT_MM) and top > _LEAST_HEIGHT_MM:
                    found[part.address] = top
            if not found:
                break
            known |= found
        return patches

    def classes(self) -> tuple[ViewClass, ...]:
        """Return the view classes of the run's frames."""
        return view_classes(self.head)[0]


class Evidence(NamedTuple):
    """What the pictures say of n parts, before probabilities."""

    misfit: Floats
    """(n,) as a multiple of the usual one; NaN if nothing is known."""
    contrast: Floats
    """(n,) contrast against that of the board, logarithm."""
    level: Floats
    """(n,) difference of brightness, grey levels of the template."""
    unlike: Floats
    """(n,) how unlike good parts a part looks: misfit with the squares of the deviations of contrast and brightness."""
    other: Floats
    """(n,) the same against the kind of part of similar size that it is most like."""
    place_mm: Floats
    """(n, 2) along the CAD axes."""
    turn_deg: Floats
    noise_mm: Floats
    """(n,) standard deviation of the place by noise and differences alone."""
    noise_deg: Floats
    quarters: NDArray[np.int_]
    """(n,) orientation that fits best, quarters of a turn."""
    ratio: Floats
    """(n, 4) logarithm of the misfit by quarters of a turn, less that of the upright part; NaN if it is not known."""
    marks: Floats
    """(n, 4) the same that is expected of a part that lies upright."""
    lift: Floats
    """(n,) height by parallax as a share of the expected one; NaN if unknown."""
    lift_sigma: Floats
    wide: Floats
    """The same of the body with a strip around it."""
    wide_sigma: Floats
    lifts: Floats
    """(n, 2) `lift` and `wide` of the part on good boards; NaN where they are unknown."""
    frames: NDArray[np.int_]
    boards: NDArray[np.int_]
    samples: NDArray[np.int_]
    searched: NDArray[np.bool_]


@dataclass
class SoFar:
    """What earlier calls for other parts of the same run have found."""

    gains: Gains = field(default_factory=dict)
    searched: int = 0
    """Number of parts that were searched."""
    exchanged: int = 0
    """Number of parts that were compared with other kinds."""
    blank: Counter[str] = field(default_factory=Counter)
    """By light: number of parts whose pictures are saturated or black."""
    shown: Counter[str] = field(default_factory=Counter)
    """By light: number of parts that its frames show."""


def collect(
    run: Run, models: Models, parts: Sequence[Component], so_far: SoFar | None = None
) -> tuple[RunPatches, Evidence]:
    """Collect what the pictures of a run say of some of its parts; calls for one run share `so_far`."""
    patches = run.cut(parts, heights_mm=models.heights_mm)
    so_far = SoFar() if so_far is None else so_far
    for c, (light, _) in enumerate(patches.classes):
        so_far.blank[light] += int(patches.blank[:, c].sum())
        so_far.shown[light] += int((patches.blank[:, c] | (patches.frames[:, c] > 0)).sum())
    gains = so_far.gains
    first = _compare(patches, models, gains)
    off = np.hypot(*first.place_mm.T)
    odd = np.flatnonzero((first.unlike > _ODD) | ((off > _NEAR_MM) & (first.unlike > _UNLIKE)))
    odd = odd[np.argsort(-first.unlike[odd], kind="stable")][: _MOST_SEARCHED - so_far.searched]
    so_far.searched += len(odd)
    if not len(odd):
        return patches, first
    again = _search(run, models, patches, odd, gains)
    # A place where the part still looks otherwise is no better than that of the CAD data.
    closer = again.unlike < np.minimum(_BETTER * first.unlike[odd], _FITS)
    better = np.flatnonzero(closer & ~(again.lift < first.lift[odd] - _LOWER))
    for old, new in zip(first, again, strict=True):
        old[odd[better]] = new[better]
    found = first
    found.searched[odd] = True
    strange = odd[found.unlike[odd] > _ODD][: _MOST_EXCHANGED - so_far.exchanged]
    so_far.exchanged += len(strange)
    if len(strange):
        found.other[strange] = np.minimum(found.other[strange], _as_others(run, models, patches, strange, gains))
    return patches, found


def _as_others(run: Run, models: Models, patches: RunPatches, odd: NDArray[np.int_], gains: Gains) -> Floats:
    """Return how unlike the most similar kind of part of about their size parts look (n,)."""
    mm = run.board_type.mm_per_unit
    kinds = {
        kind_of(c, run.board_type): c for c in run.board_type.components if kind_of(c, run.board_type) in models.names
    }
    made, of = [], []
    for n, k in enumerate(odd.tolist()):
        part, own = patches.parts[k], patches.grids[patches.grid[k]].name
        near = [
            (abs(c.width - part.width) + abs(c.height - part.height), name, c)
            for name, c in kinds.items()
            if name != own and max(abs(c.width - part.width), abs(c.height - part.height)) * mm < _SIMILAR_MM
        ]
        for _, name, c in sorted(near, key=lambda v: v[:2])[:_MOST_KINDS]:
            size = {"width": c.width, "height": c.height, "package": c.package, "ref": f"{n} {name}", "panel": None}
            height = {"body_height": (patches.height_mm[k] / mm) or None}
            made.append(part.model_copy(update=size | height))
            of.append(n)
    least = np.full(len(odd), np.inf)
    if made:
        np.minimum.at(least, of, np.nan_to_num(_compare(run.cut(made), models, gains).unlike, nan=np.inf))
    return least


def _search(run: Run, models: Models, patches: RunPatches, odd: NDArray[np.int_], gains: Gains) -> Evidence:
    """Search parts in wider patches, and compare them where they were found."""
    mm = run.board_type.mm_per_unit
    side = {k: 0.7 * min(patches.parts[k].width, patches.parts[k].height) * mm + 0.2 for k in odd.tolist()}
    moves: dict[str, tuple[float, float, float]] = {patches.parts[k].address: (0.0, 0.0, 0.0) for k in odd.tolist()}
    for margin in (0.6, 0.9, 1.4, 2.2, 3.6, 6.0):
        mine = [k for k, s in side.items() if s <= margin]
        for k in mine:
            del side[k]
        if not mine:
            continue
        wide = run.cut([patches.parts[k] for k in mine], heights_mm=models.heights_mm, margin_mm=margin)
        rank = np.zeros(len(mine), np.int_)
        for g in range(len(wide.grids)):
            rank[wide.members(g)] = np.arange(len(wide.members(g)))
        for n, k in enumerate(mine):
            grid = patches.grids[patches.grid[k]]
            for c, view in enumerate(wide.classes):
                kinds, picture = models.kinds(grid, view), wide.values[wide.grid[n], c][rank[n]]
                if not kinds or np.isnan(picture).any():
                    continue
                bodies = models.bodies(grid, view)
                kinds = bodies or kinds
                kind = next((v for v in kinds if patches.parts[k].address in (v.addresses or ())), kinds[0])
                templates = {0: kind.template} | {q: t for q, t in kind.turned.items() if kind.asymmetry[q] > VISIBLE}
                found = search(picture, wide.grids[wide.grid[n]], templates, grid, weighted=bool(bodies))
                if found is not None:
                    x, y = wide.cad_mm_from_px[n] @ found.pose[:2]
                    moves[patches.parts[k].address] = (float(x), float(y), -float(np.degrees(found.pose[2])))
                break
    moved = [patches.parts[k] for k in odd.tolist()]
    return _compare(run.cut(moved, heights_mm=models.heights_mm, moves=moves), models, gains, moves)


class _Likeness(NamedTuple):
    """How k patches of one class look against one template."""

    unlike: Floats
    log_misfit: Floats
    contrast: Floats
    level: Floats
    place: Floats
    """(k, 3) mm along the CAD axes, and degrees."""
    weight: Floats
    """(k,) of the place."""
    certainty: Floats
    """(k, 2) inverse variances of place and turn by noise."""
    ratio: Floats
    marks: Floats
    known: Floats
    """(k, 2) numbers of boards and of parts that the template was made of."""


def _compare(
    patches: RunPatches, models: Models, gains: Gains, moves: Mapping[str, tuple[float, float, float]] | None = None
) -> Evidence:
    """Compare the patches of a run with those of good boards.

    `gains` keeps the contrast of the good parts of the run by kind and class; it is filled where it is empty.
    """
    n = len(patches.parts)
    sums = _Likeness(*(np.zeros((n, *shape)) for shape in ((), (), (), (), (3,), (), (2,), (4,), (4,), (2,))))
    classes = np.zeros(n)
    # A plain body resembles plain ground: the height must confirm it.
    known = patches.height_mm > _LEAST_HEIGHT_MM
    stands = known & (patches.above_mm > (_LOWER - 1) * patches.height_mm)
    for g, grid in enumerate(patches.grids):
        mine = patches.members(g)
        for c, view in enumerate(patches.classes):
            kinds, shown = models.kinds(grid, view), patches.frames[mine, c] > 0
            if not kinds or not shown.any():
                continue
            some, pictures = mine[shown], patches.values[g, c][shown]
            found = _like(kinds[0], pictures, patches.cad_mm_from_px[some], (grid.name, c), gains)
            others = [(v, v.addresses, False) for v in kinds[1:]]
            others += [(v, v.addresses, True) for v in models.bodies(grid, view)] if moves else []
            for variant, its, confirmed in others:
                at = [
                    n for n, k in enumerate(some)
                    if (its is None or patches.parts[k].address in its) and (stands[k] or not confirmed)
                ]  # fmt: skip
                if at:
                    other = _like(variant, pictures[at], patches.cad_mm_from_px[some[at]], (grid.name, c), gains)
                    closer = other.unlike < found.unlike[at]
                    for old, new in zip(found, other, strict=True):
                        old[np.array(at)[closer]] = new[closer]
            either = [n for n, k in enumerate(some) if patches.parts[k].address in kinds[0].any_way]
            found.marks[either] = 0.0
            found = found._replace(unlike=np.log(found.unlike), place=found.place * found.weight[:, None])
            for total, value in zip(sums, found, strict=True):
                total[some] += value
            classes[some] += 1
    return _evidence(patches, sums, classes, models, moves)


def _like(kind: Kind, pictures: Floats32, cad_mm_from_px: Floats, key: tuple[str, int], gains: Gains) -> _Likeness:
    """Compare patches (k, h, w) with one template, upright and turned."""
    best = kind.template.fit(pictures)
    misfit = {0: best.misfit.copy()}
    for q, template in kind.turned.items():
        if kind.asymmetry[q] < VISIBLE:
            continue
        misfit[q] = _turned_misfit(template, pictures, best, kind)
        at = np.flatnonzero(misfit[q] < _TURNED * best.misfit)
        if len(at):
            for old, new in zip(best, template.fit(pictures[at]), strict=True):
                old[at] = new
    # What is flat fits any template of little contrast.
    lit = np.abs(np.log(np.maximum(best.gain, 0.02) / kind.gain)) < np.log(_MOST_DIMMER)
    usual = (best.misfit < _UNLIKE * kind.usual) & lit
    if key not in gains and usual.sum() > 2:
        gains[key] = max(float(np.median(best.gain[usual])) / kind.gain, 0.05)
    of_class = [v for (_, k), v in gains.items() if k == key[1]]
    gain = kind.gain * gains.get(key, float(np.median(of_class)) if of_class else 1.0)
    m = np.maximum(best.misfit / kind.usual, 1e-3)
    contrast, level = kind.deviations(best, gain)
    px = np.einsum("nij,nj->ni", cad_mm_from_px, best.pose[:, :2])
    mm_per_px = np.sqrt(np.abs(np.linalg.det(cad_mm_from_px)))
    variance = np.maximum(best.covariance * best.misfit[:, None, None], 1e-12)
    certainty = 1 / np.column_stack(
        [variance[:, (0, 1), (0, 1)].max(1) * mm_per_px**2, np.degrees(np.sqrt(variance[:, 2, 2])) ** 2]
    )
    ratio, marks = np.zeros((2, len(pictures), 4))
    for q, value in misfit.items():
        ratio[:, q] = np.log(np.maximum(value, 1e-3) / np.maximum(misfit[0], 1e-3))
        marks[:, q] = np.log(max(kind.asymmetry[q], 1e-3)) if q else 0.0
    place = np.column_stack([px, -np.degrees(best.pose[:, 2])])
    known = np.tile([float(kind.boards), float(kind.samples)], (len(pictures), 1))
    return _Likeness(
        kind.unlikeness(best, gain), np.log(m), contrast, level, place, certainty[:, 0].copy(), certainty, ratio, marks,
        known,
    )  # fmt: skip


def _evidence(
    patches: RunPatches,
    sums: _Likeness,
    classes: Floats,
    models: Models,
    moves: Mapping[str, tuple[float, float, float]] | None,
) -> Evidence:
    """Make evidence of sums over the classes that show each part."""
    n = len(classes)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = _Likeness(*(v / classes.reshape(-1, *([1] * (v.ndim - 1))) for v in sums))
        place = sums.place / sums.weight[:, None]
        noise = 1 / np.sqrt(sums.certainty)
        height = np.where(patches.height_mm > _LEAST_HEIGHT_MM, patches.height_mm, np.nan)
        lift, lift_sigma = 1 + patches.above_mm / height, patches.above_sigma_mm / height
        wide, wide_sigma = 1 + patches.wide_mm / height, patches.wide_sigma_mm / height
    unknown = np.full(2, np.nan)
    lifts = np.array([models.lifts.get(p.address, unknown) for p in patches.parts], np.float64).reshape(-1, 2)
    told = np.nan_to_num(mean.marks) > np.log(VISIBLE)
    quarters = np.argmin(np.where(told, np.nan_to_num(mean.ratio), np.where(np.arange(4) == 0, 0.0, np.inf)), 1)
    if moves:
        place = place + np.array([moves[p.address] for p in patches.parts])
    ratio = np.where(mean.marks != 0, mean.ratio, np.nan)
    boards, samples = np.nan_to_num(mean.known).round().astype(np.int_).T
    return Evidence(
        np.exp(mean.log_misfit), mean.contrast, mean.level, np.exp(mean.unlike), np.full(n, np.inf), place[:, :2],
        place[:, 2], noise[:, 0], noise[:, 1], quarters, ratio, mean.marks, lift, lift_sigma, wide,
        wide_sigma, lifts, patches.frames.sum(1), boards, samples, np.zeros(n, np.bool_),
    )  # fmt: skip


def _turned_misfit(template: Template, pictures: Floats32, best: Fit, kind: Kind) -> Floats:
    """Return the misfit with the template turned; it is fitted anew only where a part may lie so."""
    # Where the upright part fits as good ones do, the turned template is compared at the same place.
    misfit = template.compare(pictures, best.pose).misfit
    odd = np.flatnonzero(best.misfit > _UNLIKE * kind.usual)
    if len(odd):
        misfit[odd] = template.fit(pictures[odd], rounds=3).misfit
    return misfit
