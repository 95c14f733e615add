"""What the parts of one kind have in common: template, variance of its pixels, and how far good ones differ from it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.parts.learned import TaughtBoard
from vaoi_station.parts.patches import Grid, ViewClass, same_class
from vaoi_station.parts.registration import Fit, Floats, Floats32, Template, warp

_ROUNDS = 3
_PRIOR_SD, _PRIOR_SAMPLES = 14.0, 2.0
"""Standard deviation of a pixel, grey levels, that is assumed, and the number of parts as which this counts."""
_LEAST_VARIANCE = 9.0
_CONTRAST_SD, _LEVEL_SD = 0.12, 8.0
"""Spread of contrast (logarithm) and brightness (grey levels) of good parts that is assumed.

Learned ones are at least half of it."""
STRANGE = 6.0
"""How unlike the others a part must look to be a variant, or to be compared with other kinds."""
VISIBLE = 7.0
"""Least misfit of a part the wrong way round, as a multiple of the usual one, with which its marks are visible.

Lettering stays below it: good parts have other letters from lot to lot."""
_CLEARLY = 2.0
"""Least misfit of most taught parts with the template turned, as a multiple of that upright, if it shows marks.

A lamp from one side shades parts by the way they lie, which looks like a mark of those that lie alike."""
_MOST_LEARNED = 240
"""Number of patches of one kind that make its template; more make it no better, and take time and memory."""
_MOST_VARIANTS = 6
_FEW, _MOST_COMPARED = 3, 90
"""Number of patches from which on those that look otherwise do not count, and of those that are compared in pairs."""
_SAME_KIND = 0.45
"""Largest difference of two patches of parts of one kind, as a share of the contrast."""
_ALIGNED, _CONTRASTS = 4.0, 0.4
"""Largest misfit of an aligned patch of the same kind, as a multiple of the usual one, and difference of the logarithms
of their contrasts. Patches are compared in pairs before they are aligned, which favours those off to one side."""
_RAISED = 0.3
"""Share of the expected height below which a part of a taught board is missing, and is no variant."""
_BODY, _LEADS_WEIGHT = 0.62, 0.02
"""Share of width and height of a footprint with leads that is body, and weight of the pixels around it."""
_SLENDER, _CHIP_MM = 1.6, 3.6
"""Least ratio of the sides and largest length of parts without leads: chips, whose ends move with them."""
_TRIM = 0.9
"""Share of the best fitting parts that make the template; a part that is absent, or of another kind, does not."""


class Kind(NamedTuple):
    """The good parts of one kind in one view class."""

    template: Template
    usual: float
    """Misfit of a good part."""
    gain: float
    gain_sd: float
    """Spread of the logarithm of the contrast of good parts."""
    level_sd: float
    """Spread of their brightness, grey levels."""
    level: float
    """Mean grey level of the template on the body."""
    samples: int
    boards: int
    turned: dict[int, Template]
    """By quarters of a turn, counter-clockwise: the template of a part that lies so."""
    asymmetry: dict[int, float]
    """By quarters of a turn: misfit of a part that lies so, as a multiple of the usual one."""
    fit: Fit
    """That of all taught parts, ordered by board."""
    of: tuple[tuple[str, str], ...]
    """Board and address of each taught part."""
    any_way: frozenset[str]
    """The parts that do not look upright on good boards, so that their orientation is not told: a lamp from one side
    shades those that lie otherwise in other places."""
    addresses: frozenset[str] | None
    """The parts that the variant is for; None: all of the kind."""
    shaded: frozenset[int]
    """Quarters of a turn by which the template differs, but not most parts from one that lies so: no marks."""

    def unlikeness(self, fit: Fit, gain: float) -> Floats:
        """Return how unlike the template parts look; `gain` is the contrast of the good parts of their run."""
        contrast, level = self.deviations(fit, gain)
        return np.asarray(fit.misfit / self.usual + ((contrast / self.gain_sd) ** 2 + (level / self.level_sd) ** 2) / 2)

    def deviations(self, fit: Fit, gain: float) -> tuple[Floats, Floats]:
        """Return contrast (logarithm) and brightness (grey levels of the template) against those of good parts."""
        level = (fit.gain / gain - 1) * self.level + fit.offset / gain
        return np.log(np.maximum(fit.gain, 0.02) / gain), np.asarray(level)


class _Taught(NamedTuple):
    """The patches of one kind of parts on all taught boards."""

    patches: Floats32
    of: tuple[tuple[str, str], ...]
    """Board and address of each."""
    raised: NDArray[np.bool_]
    """(n,) whether the part is not known to be missing: its height is not that of the bare board."""

    def some(self, chosen: Sequence[int]) -> _Taught:
        """Return some of the patches."""
        mine = list(chosen)
        return _Taught(self.patches[mine], tuple(self.of[n] for n in mine), self.raised[mine])


def learn_kinds(grid: Grid, view: ViewClass, boards: Sequence[TaughtBoard]) -> tuple[Kind, ...]:
    """Return what the taught boards show of one kind of parts under one light; empty if none shows it.

    Parts of one package and size are one kind, whatever their place. Those that look otherwise than the rest on all
    taught boards are variants, for their own places: another value, another source. Those with which no others are
    alike, as tall parts that each camera sees from another side, are variants each by itself.
    """
    taught = _collect(grid, view, boards)
    if taught is None:
        return ()
    kinds = [_learn(grid, taught, None)]
    left = taught
    for variant in range(_MOST_VARIANTS + 1):
        unlike: dict[str, list[float]] = {}
        measured = kinds[-1].unlikeness(kinds[-1].fit, kinds[-1].gain)
        for (_, address), value in zip(left.of, np.where(left.raised, measured, -np.inf).tolist(), strict=True):
            unlike.setdefault(address, []).append(value)
        some = frozenset(a for a, u in unlike.items() if min(u) > -np.inf and np.median(u) > STRANGE)
        mine = [n for n, (_, a) in enumerate(left.of) if a in some]
        if not mine:
            break
        if len(mine) == len(left.of) or variant == _MOST_VARIANTS:
            for address in sorted(some):
                own = [n for n in mine if left.of[n][1] == address]
                kinds.append(_learn(grid, left.some(own), frozenset({address}), kinds[0].shaded))
            break
        left = left.some(mine)
        kinds.append(_learn(grid, left, some, kinds[0].shaded))
    return tuple(kinds)


def _collect(grid: Grid, view: ViewClass, boards: Sequence[TaughtBoard]) -> _Taught | None:
    found: list[tuple[NDArray[np.uint8], np.float32]] = []
    of: list[tuple[str, str]] = []
    raised: list[NDArray[np.bool_]] = []
    for board in boards:
        names = [g.name for g in board.grids]
        classes = [n for n, c in enumerate(board.classes) if same_class(c, view)]
        if grid.name not in names or not classes:
            continue
        n, c = names.index(grid.name), classes[0]
        known = np.asarray(board.patches[n][:, c].any((1, 2)), np.bool_)
        scale = np.float32(view.exposure / board.classes[c].exposure)
        found += [(p, scale) for p in board.patches[n][known, c]]
        of += [(board.name, a) for a, k in zip(board.addresses[n], known.tolist(), strict=True) if k]
        expected, measured, _ = board.heights_mm[n][known].T
        raised.append(~((expected > 0) & (measured < _RAISED * expected)))
    if not found:
        return None
    patches = np.empty((len(found), grid.height, grid.width), np.float32)
    for out, (patch, scale) in zip(patches, found, strict=True):
        out[:] = _sized(patch, grid) * scale
    return _Taught(patches, tuple(of), np.concatenate(raised))


def _learn(grid: Grid, taught: _Taught, addresses: frozenset[str] | None, shaded: frozenset[int] = frozenset()) -> Kind:
    """Learn the template of a kind, or of the variant at some addresses."""
    mask = body_mask(grid)
    n = min(len(taught.patches), _MOST_LEARNED)
    some = np.linspace(0, len(taught.patches) - 1, n).astype(int)
    patches = taught.patches[some]
    members = _majority(patches, mask)
    picture = np.asarray(np.median(patches[members], 0), np.float32)
    variance = np.full(picture.shape, _PRIOR_SD**2, np.float32)
    pose = np.zeros((n, 3))
    for _ in range(_ROUNDS if n > 1 else 1):
        fit = Template(picture, variance, mask).fit(patches, pose, rounds=3, limit_px=6.0)
        if n >= _FEW:
            members = _aligned(fit, members)
        good = members & (fit.misfit <= np.quantile(fit.misfit[members], _TRIM))
        pose = fit.pose - _middle(fit.pose[members])
        safe = np.where(np.abs(fit.gain) < 0.2, 0.2, fit.gain)
        aligned = (warp(patches, pose) - fit.offset[:, None, None]) / safe[:, None, None]
        picture = aligned[good].mean(0).astype(np.float32)
        count = int(np.count_nonzero(good))
        rest = np.square(aligned[good] - picture).sum(0) * (count / max(count - 1, 1))
        total = (rest + _PRIOR_SAMPLES * _PRIOR_SD**2) / (count + _PRIOR_SAMPLES) + _LEAST_VARIANCE
        variance = total.astype(np.float32)
    template = Template(picture, variance, mask)
    fit = template.fit(taught.patches, limit_px=6.0)
    learned = np.zeros(len(taught.patches), np.bool_)
    learned[some[members]] = True
    members = _aligned(fit, learned) if n >= _FEW else learned
    # A part that had a share in the template fits it better than another one will.
    count = int(np.count_nonzero(members))
    middle = float(np.median(fit.misfit[members])) * (count + 1) / max(count - 1, 1)
    usual = (_PRIOR_SAMPLES + count * middle) / (_PRIOR_SAMPLES + count) if count > 1 else 1.0
    turned = {q: _turned(template, q) for q in _turns(grid)}
    asymmetry = {q: float(t.fit(picture[None]).misfit[0]) / usual for q, t in turned.items()}
    upright = {
        q: np.log(np.maximum(t.compare(taught.patches, fit.pose).misfit, 1e-3) / np.maximum(fit.misfit, 1e-3))
        for q, t in turned.items()
    }
    unclear = {q for q, v in upright.items() if asymmetry[q] > VISIBLE and np.quantile(v, 1 - _TRIM) < np.log(_CLEARLY)}
    asymmetry |= dict.fromkeys(unclear | set(shaded), 0.0)
    other = [n for q, v in upright.items() if asymmetry[q] > VISIBLE for n in np.flatnonzero(v <= 0)]
    level = float((picture * mask).sum() / mask.sum())
    gain, offset = fit.gain[members], fit.offset[members]
    gain_sd = _spread(np.log(np.maximum(gain, 0.05)), _CONTRAST_SD)
    level_sd = _spread((gain - np.median(gain)) * level + offset, _LEVEL_SD)
    boards = len({board for board, _ in taught.of})
    return Kind(
        template, usual, float(np.median(gain)), gain_sd, level_sd, level, count, boards, turned, asymmetry, fit,
        taught.of, frozenset(taught.of[n][1] for n in other), addresses, frozenset(unclear),
    )  # fmt: skip


def _majority(patches: Floats32, mask: Floats32) -> NDArray[np.bool_]:
    """Return which patches look like the one that most others are like.

    Resistors and capacitors of one size are one kind where the board type states no packages.
    """
    n = len(patches)
    if n < _FEW:
        return np.ones(n, np.bool_)
    shown = patches[:, mask > 0.5].astype(np.float32)
    some = shown[np.linspace(0, n - 1, min(n, _MOST_COMPARED)).astype(int)]
    power = np.square(some).mean(1)
    apart = np.sqrt(np.maximum(power[:, None] + power[None] - 2 * (some @ some.T) / some.shape[1], 0))
    middle = some[np.argmin(np.sort(apart, 1)[:, : len(some) // 3 + 1].mean(1))]
    members = np.sqrt(np.square(shown - middle).mean(1)) < _SAME_KIND * max(float(middle.std()), _CONTRAST_SD)
    return members if members.sum() >= _FEW - 1 else np.ones(n, np.bool_)


def _aligned(fit: Fit, members: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which patches fit a template about as well as most of its members do; the members if none does."""
    contrast = np.log(np.maximum(fit.gain, 0.02))
    near = np.abs(contrast - np.median(contrast[members])) < _CONTRASTS
    found = np.asarray(near & (fit.misfit < _ALIGNED * np.median(fit.misfit[members])))
    # Of two members whose contrast differs much, neither is near the median.
    return found if found.any() else members


def _middle(poses: Floats) -> Floats:
    """Return the mean of poses (n, 3) without those that lie apart: with few parts it is closer than the median."""
    middle = np.median(poses, 0)
    off = np.abs(poses - middle)
    near = off <= 4.5 * np.median(off, 0) + 1e-9
    return np.asarray((poses * near).sum(0) / near.sum(0))


def _spread(values: Floats, prior: float) -> float:
    """Return the robust standard deviation of values, with a prior that counts as two of them."""
    found = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return float(
        np.sqrt((_PRIOR_SAMPLES * prior**2 + len(values) * max(found, prior / 2) ** 2) / (_PRIOR_SAMPLES + len(values)))
    )


def is_chip(grid: Grid) -> bool:
    """Return whether parts of this shape have no leads."""
    long, short = max(grid.body_px), min(grid.body_px)
    return long > _SLENDER * short and long < _CHIP_MM * grid.px_per_mm


def body_of(kind: Kind, grid: Grid) -> Kind:
    """Return a kind in which leads count little: they cover pads, which stay when the part moves."""
    old = kind.template
    mask = old.mask * (_LEADS_WEIGHT + (1 - _LEADS_WEIGHT) * body_mask(grid, _BODY))
    template = Template(old.picture, old.variance, mask)
    turned = {q: _turned(template, q) for q in kind.turned}
    asymmetry = {q: float(t.fit(old.picture[None]).misfit[0]) / kind.usual for q, t in turned.items()}
    # A plain body hardly tells the contrast.
    return kind._replace(template=template, turned=turned, asymmetry=asymmetry, gain_sd=3 * kind.gain_sd)


def body_mask(grid: Grid, share: float = 1.0) -> Floats32:
    """Return the weights (h, w) of the pixels of a share of a footprint, around its centre, and its edges."""
    x = np.abs(np.arange(grid.width) - (grid.width - 1) / 2)
    y = np.abs(np.arange(grid.height) - (grid.height - 1) / 2)
    a, b = (np.clip(share * s / 2 + 0.5 - v, 0, 1) for s, v in zip(grid.body_px, (x, y), strict=True))
    return np.asarray(b[:, None] * a, np.float32)


def _turns(grid: Grid) -> tuple[int, ...]:
    """Return the quarters of a turn by which a part of this shape can lie on its place other than upright."""
    return (1, 2, 3) if grid.width == grid.height else (2,)


def _turned(template: Template, quarters: int) -> Template:
    """Return a template turned counter-clockwise as seen."""
    turn = [np.ascontiguousarray(np.rot90(a, quarters)) for a in (template.picture, template.variance, template.mask)]
    return Template(*turn)


def _sized(patch: NDArray[np.uint8], grid: Grid) -> Floats32:
    values = patch.astype(np.float32)
    if values.shape == (grid.height, grid.width):
        return values
    return np.asarray(cv2.resize(values, (grid.width, grid.height), interpolation=cv2.INTER_AREA), np.float32)


class Models:
    """The kinds of parts of taught boards, each computed when it is first used."""

    def __init__(self, boards: Sequence[TaughtBoard]) -> None:
        """Store the boards."""
        self.boards = tuple(boards)
        self._kinds: dict[tuple[Grid, ViewClass], tuple[Kind, ...]] = {}
        self._bodies: dict[tuple[Grid, ViewClass], tuple[Kind, ...]] = {}
        self.names = frozenset(grid.name for board in boards for grid in board.grids)
        self.addresses = frozenset(address for board in boards for some in board.addresses for address in some)
        heights: dict[str, list[NDArray[np.float32]]] = {}
        for board in boards:
            for addresses, values in zip(board.addresses, board.heights_mm, strict=True):
                for address, value in zip(addresses, values, strict=True):
                    heights.setdefault(address, []).append(value)
        # A board that states no height says nothing of the plane; its heights are those of parallax on the board's.
        heights = {a: [one for one in v if one[0] > 0] or v for a, v in heights.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # parts without any height have none here
            middle = {a: np.nanmedian(np.stack(v), 0) for a, v in heights.items()}
        self.heights_mm = {a: float(v[0]) for a, v in middle.items() if v[0] > 0}
        """Planes on which the patches of good boards were cut, by address, for parts whose CAD data state no height."""
        self.lifts = {a: v[1:] / v[0] for a, v in middle.items() if v[0] > 0}
        """Heights by parallax as shares of the expected ones, alone and with a strip, by address: leads are lower."""

    def kinds(self, grid: Grid, view: ViewClass) -> tuple[Kind, ...]:
        """Return what is known of a kind of parts in a view class: what all have in common, then variants."""
        key = grid, view
        if key not in self._kinds:
            self._kinds[key] = learn_kinds(grid, view, self.boards)
        return self._kinds[key]

    def bodies(self, grid: Grid, view: ViewClass) -> tuple[Kind, ...]:
        """Return the same for parts that do not lie on their pads; empty for parts without leads."""
        key = grid, view
        if key not in self._bodies:
            self._bodies[key] = () if is_chip(grid) else tuple(body_of(kind, grid) for kind in self.kinds(grid, view))
        return self._bodies[key]
