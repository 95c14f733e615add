"""Upright patches of the parts of a run: one per part and view class, averaged over the frames that show it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Component, RecordingHead, Stitch
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.rendering import Framing, ViewCalculator
from vaoi_station.rendering.selection import frame_facts
from vaoi_station.rendering.temporary import render_all
from vaoi_station.rendering.views import ViewTable

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int_]

MARGIN_MM = 0.3
"""Strip around the footprint: ends of pads and the ground between parts."""
MOST_PX = 2800
"""Largest number of pixels of all patches of one part: with it a part and board take less than 3 kB."""
_MOST_CLASSES = 3
"""Largest number of view classes; further ones are left out."""
_EXPOSURE_STEP = 1.5
"""Frames whose exposure · gain differ by more than this factor are of different classes."""
_BRIGHT, _DARK = 250.0, 4.0
"""Grey levels at which a pixel says nothing."""
STRIP_MM = 0.075
"""Strip around the body in which the ends of the pads of a part that is absent show that nothing stands there."""
_AT_ONCE = 64
"""Number of parts whose heights are computed at once, which bounds the memory."""
_MATRIX_PX = 0.03
"""Standard deviation of the place of a frame against another one, px of a frame."""
_LEAST_TEXTURE, _MOST_NOISE = 0.05, 4.0
"""Least share of the gradients that is taken for texture, the rest being noise; largest noise, grey levels."""
_BLANK = 0.5
"""Share of such pixels on a body from which on it cannot be judged."""
_SEEN = 0.97
"""Least share of a body that the frames of one class must show together."""
_LEAST_NOISE = 1.0
"""Least standard deviation of a pixel of an averaged patch, grey levels."""


class Grid(NamedTuple):
    """The pixels of the patches of one kind of part: same package and same size."""

    name: str
    """Package and size; the key under which parts are pooled."""
    width: int
    height: int
    px_per_mm: float
    body_px: tuple[float, float]
    """Width and height of the footprint."""

    @property
    def px(self) -> int:
        """Number of pixels of a patch."""
        return self.width * self.height


class ViewClass(NamedTuple):
    """What the frames have in common that are averaged: the light of their rows, and their exposure · gain in µs."""

    light: str
    exposure: float


class RunPatches(NamedTuple):
    """The patches of n parts of one run."""

    parts: tuple[Component, ...]
    grids: tuple[Grid, ...]
    grid: Ints
    """(n,) number of the grid of each part."""
    classes: tuple[ViewClass, ...]
    values: dict[tuple[int, int], Floats32]
    """By numbers of grid and class: (k, height, width) grey levels of the k parts of the grid, NaN without a view."""
    frames: Ints
    """(n, classes) number of frames that show each part whole."""
    height_mm: Floats
    """(n,) height of the plane of the patch above the board; 0 where no height is known."""
    above_mm: Floats
    """(n,) how far the part lies above that plane by the parallax of its frames; NaN for less than two frames."""
    above_sigma_mm: Floats
    wide_mm: Floats
    """(n,) the same of the body with a strip around it, which holds the ends of its pads."""
    wide_sigma_mm: Floats
    dark: NDArray[np.bool_]
    """(n,) whether the patch is saturated or black."""
    blank: NDArray[np.bool_]
    """(n, classes) whether the pictures of a class are saturated or black: they do not count where others are not."""
    cad_mm_from_px: Floats
    """(n, 2, 2) displacement in pixels of a patch → mm along the CAD axes."""

    def members(self, grid: int) -> Ints:
        """Return the numbers of the parts of a grid, in the order of `values`."""
        return np.flatnonzero(self.grid == grid)


def kind_of(component: Component, board_type: BoardType) -> str:
    """Return the name under which parts are pooled: package and size of the footprint."""
    mm = board_type.mm_per_unit
    return f"{component.package or '?'} {component.width * mm:.2f}×{component.height * mm:.2f}"


def cut_patches(  # noqa: PLR0915  (one pass over the parts, with arrays of all of them)
    board_type: BoardType,
    run: tuple[Stitch, Sequence[Camera], RecordingHead],
    frame: Callable[[int, int], NDArray[Any] | None],
    parts: Sequence[Component],
    *,
    heights_mm: Mapping[str, float] | None = None,
    moves: Mapping[str, tuple[float, float, float]] | None = None,
    margin_mm: float = MARGIN_MM,
) -> RunPatches:
    """Cut the patches of parts out of the frames of a stitched run.

    `heights_mm` are heights of bodies by address, for parts whose CAD data state none. `moves` displaces patches: by
    address x and y along the CAD axes, mm, and degrees counter-clockwise as seen. `margin_mm` is the strip around them.

    Raises:
        StateError: the run has no CAD mapping.
    """
    stitch, cameras, head = run
    mm = board_type.mm_per_unit
    known = dict(heights_mm or {})
    known |= {p.address: p.body_height * mm for p in parts if p.body_height is not None}
    calculator = ViewCalculator(board_type, stitch, cameras)
    resolution = float(np.mean([c.px_per_mm for c in cameras]))
    framing = Framing(px_per_mm=resolution, margin_mm=margin_mm, align="part", plane="top")
    if moves:
        parts = [_moved(p, moves[p.address], board_type) for p in parts]
    usable = known if calculator.knows_heights else {}
    table = calculator.compute_all(list(parts), min_coverage=0.1, framing=framing, heights_mm=usable or {"": 0.0})
    missing = set(head.missing)
    keys = [(i, j) for i, j in table.key.tolist()]
    classes, class_of, exposure = view_classes(head)

    def grey(camera: int, row: int) -> NDArray[Any] | None:
        pixels = None if (camera, row) in missing else frame(camera, row)
        return None if pixels is None else np.ascontiguousarray(eight_bit_grey(pixels))

    shown = _whole(table, cameras)
    images = render_all(table, grey)
    lift = _lifts(table)
    n = len(parts)
    names = [kind_of(p, board_type) for p in parts]
    grids, number = _grids(names, table, 2 * margin_mm * resolution, len(classes))
    values = {
        (g, c): np.full((int((number == g).sum()), grid.height, grid.width), np.nan, np.float32)
        for g, grid in enumerate(grids)
        for c in range(len(classes))
    }
    rank = np.zeros(n, np.int_)
    for g in range(len(grids)):
        rank[number == g] = np.arange(np.count_nonzero(number == g))
    frames, above, weight = np.zeros((n, len(classes)), np.int_), np.zeros((n, 2)), np.zeros((n, 2))
    blank = np.zeros((n, len(classes)), np.bool_)
    first = np.searchsorted(table.component, np.arange(n + 1))
    for g, grid in enumerate(grids):
        masks = _inside(grid, -1.0), _inside(grid, STRIP_MM * grid.px_per_mm)
        for c, view in enumerate(classes):
            seen: list[_Views] = []
            for k in np.flatnonzero(number == g).tolist():
                use = [v for v in range(first[k], first[k + 1]) if images[v] is not None and class_of[keys[v]] == c]
                if not use:
                    continue
                to_class = [view.exposure / exposure[keys[v]] for v in use]
                stack = [_reduced(images[v], grid) * np.float32(f) for v, f in zip(use, to_class, strict=True)]
                whole = [n for n, v in enumerate(use) if shown[v]]
                if whole:
                    mean = np.mean([stack[n] for n in whole], 0, dtype=np.float32)
                else:
                    joined = _joined(np.stack(stack), np.stack([_seen(table, v, grid, cameras) for v in use]), masks[0])
                    if joined is None:
                        continue
                    mean = joined
                values[g, c][rank[k]], frames[k, c] = mean, len(whole) or len(use)
                middle = values[g, c][rank[k]][masks[0]]
                blank[k, c] = np.count_nonzero((middle > _BRIGHT) | (middle < _DARK)) > _BLANK * middle.size
                if len(whole) > 1:
                    slopes = lift[[use[n] for n in whole]] * (grid.px_per_mm / resolution)
                    clipped = _BRIGHT * max(to_class[n] for n in whole)
                    seen.append(_Views(k, values[g, c][rank[k]], [stack[n] for n in whole], slopes, clipped))
            for begin in range(0, len(seen), _AT_ONCE):
                some = seen[begin : begin + _AT_ONCE]
                for m, mask in enumerate(masks):
                    off, certainty = _parallax(some, mask)
                    above[[one.part for one in some], m] += off * certainty
                    weight[[one.part for one in some], m] += certainty
    said = np.asarray(((frames > 0) & ~blank).any(1), np.bool_)
    # A lamp that is out says nothing of a part that another light shows.
    frames[blank & said[:, None]] = 0
    height = np.where(table.on_top, table.above_mm, 0.0)
    measured = (weight > 0) & calculator.knows_heights
    with np.errstate(invalid="ignore", divide="ignore"):
        above_mm, sigma = np.where(measured, above / weight, np.nan), np.where(measured, 1 / np.sqrt(weight), np.nan)
    scale = resolution * mm / np.array([grid.px_per_mm for grid in grids])[number]
    cad_from_px = table.crops.cad_from_crop[:, :2, :2] * scale[:, None, None]
    return RunPatches(
        tuple(parts), grids, number, classes, values, frames, height, above_mm[:, 0], sigma[:, 0], above_mm[:, 1],
        sigma[:, 1], (frames > 0).any(1) & ~said, blank, cad_from_px,
    )  # fmt: skip


def _moved(part: Component, move: tuple[float, float, float], board_type: BoardType) -> Component:
    """Return a part displaced along the CAD axes, mm, and turned, degrees counter-clockwise as seen."""
    x, y = part.center
    turn = move[2] if board_type.side == "top" else -move[2]
    centre = x + move[0] / board_type.mm_per_unit, y + move[1] / board_type.mm_per_unit
    return part.model_copy(update={"center": centre, "rotation": part.rotation + turn})


def view_classes(
    head: RecordingHead,
) -> tuple[tuple[ViewClass, ...], dict[tuple[int, int], int], dict[tuple[int, int], float]]:
    """Return the view classes of a recording, and by frame the number of its class and its exposure · gain."""
    facts = frame_facts(head)
    exposure = {key: (f.exposure_us or 1.0) * (f.gain or 1.0) for key, f in facts.items()}
    found: list[list[ViewClass]] = []
    number: dict[tuple[int, int], int] = {}
    for key in sorted(facts, key=lambda k: (facts[k].light or "", exposure[k], k)):
        view = ViewClass(facts[key].light or "", exposure[key])
        same = [n for n, members in enumerate(found) if same_class(members[0], view)]
        if not same:
            found.append([])
            same = [len(found) - 1]
        found[same[0]].append(view)
        number[key] = same[0]
    kept = sorted(sorted(range(len(found)), key=lambda n: -len(found[n]))[:_MOST_CLASSES])
    at = {n: k for k, n in enumerate(kept)}
    return tuple(found[n][0] for n in kept), {key: at.get(n, -1) for key, n in number.items()}, exposure


def same_class(a: ViewClass, b: ViewClass) -> bool:
    """Return whether pictures of two view classes can be compared."""
    return a.light == b.light and abs(math.log(a.exposure / b.exposure)) < math.log(_EXPOSURE_STEP)


def _grids(names: Sequence[str], table: ViewTable, strips_px: float, classes: int) -> tuple[tuple[Grid, ...], Ints]:
    """Return the grids of the parts, and the number of each part's; all parts of one grid have patches of one size."""
    found: dict[str, Grid] = {}
    for name, (w, h), px_per_mm in zip(names, table.crops.size.tolist(), table.crops.px_per_mm.tolist(), strict=True):
        if name in found:
            continue
        scale = min(1.0, math.sqrt(MOST_PX / max(classes, 1) / (w * h)))
        width, height = max(round(w * scale), 4), max(round(h * scale), 4)
        factor = width / w
        strip = strips_px * factor
        # Of less than a pixel, nothing could be compared.
        body = max(width - strip, 1.0), max(height - strip, 1.0)
        found[name] = Grid(name, width, height, px_per_mm * factor, body)
    order = {name: n for n, name in enumerate(found)}
    return tuple(found.values()), np.array([order[name] for name in names], np.int_)


def _inside(grid: Grid, beyond_px: float) -> tuple[slice, slice]:
    """Return which rows and columns of a patch lie on the body, or so far beyond its edges."""

    def within(size: int, body: float) -> slice:
        at = np.flatnonzero(np.abs(np.arange(size) - (size - 1) / 2) <= body / 2 + beyond_px)
        return slice(int(at[0]), int(at[-1]) + 1) if len(at) else slice(0, size)

    return within(grid.height, grid.body_px[1]), within(grid.width, grid.body_px[0])


def _whole(table: ViewTable, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Return which views show the patch with its margin."""
    size = table.crops.size[table.component] - 1
    corners = np.stack(
        [np.stack([size[:, 0] * a, size[:, 1] * b, np.ones(len(size))], -1) for a in (0, 1) for b in (0, 1)], 1
    )
    at = corners @ table.matrix.swapaxes(1, 2)
    px = at[..., :2] / at[..., 2:]
    last = np.array([(c.width_px - 1, c.height_px - 1) for c in cameras], np.float64)[table.key[:, 0]]
    return np.asarray(((px >= 0.5) & (px <= last[:, None] - 0.5)).all((1, 2)))


def _lifts(table: ViewTable) -> Floats:
    """Return by how much a body appears displaced in the picture of each view, px of the picture per mm of height."""
    centre = (table.crops.size[table.component] - 1) / 2
    m = table.matrix
    w = m[:, 2, 0] * centre[:, 0] + m[:, 2, 1] * centre[:, 1] + m[:, 2, 2]
    at = (m[:, :2, :2] @ centre[:, :, None])[..., 0] + m[:, :2, 2]
    jacobian = (m[:, :2, :2] - (at / w[:, None])[:, :, None] * m[:, None, 2, :2]) / w[:, None, None]
    return np.asarray(np.linalg.solve(jacobian, table.sights()[1][:, :, None])[..., 0])


def _reduced(image: NDArray[Any] | None, grid: Grid) -> Floats32:
    assert image is not None
    size = (grid.width, grid.height)
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _seen(table: ViewTable, view: int, grid: Grid, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Return which pixels of a patch a frame shows."""
    w, h = table.crops.size[table.component[view]].tolist()
    x, y = np.meshgrid((np.arange(grid.width) + 0.5) * w / grid.width, (np.arange(grid.height) + 0.5) * h / grid.height)
    at = np.stack([x - 0.5, y - 0.5, np.ones_like(x)], -1) @ table.matrix[view].T
    px = at[..., :2] / at[..., 2:]
    camera = cameras[table.key[view, 0]]
    return np.asarray(((px >= 2) & (px <= np.array([camera.width_px - 3, camera.height_px - 3]))).all(-1))


def _joined(stack: Floats32, seen: NDArray[np.bool_], inside: tuple[slice, slice]) -> Floats32 | None:
    """Return the picture of a part of which no frame shows the whole patch; None if too little of it is shown.

    What no frame shows, at the border, repeats what is next to it.
    """
    if float(np.mean(np.asarray(seen.any(0))[inside])) < _SEEN:
        return None
    order = np.argsort(-seen.sum((1, 2)), kind="stable")
    total, count = stack[order[0]] * seen[order[0]], seen[order[0]].astype(np.float32)
    for v in order[1:]:
        both = seen[v] & (count > 0)
        gain = float((total[both] / count[both]).mean() / max(stack[v][both].mean(), 1.0)) if both.sum() > 20 else 1.0
        total, count = total + stack[v] * np.float32(gain) * seen[v], count + seen[v]
    picture = np.asarray(np.where(count > 0, total / np.maximum(count, 1), 0), np.float32)
    _, nearest = cv2.distanceTransformWithLabels(
        (count == 0).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    shown = count > 0
    by_label = np.zeros(int(nearest.max()) + 1, np.float32)
    by_label[nearest[shown]] = picture[shown]
    return np.asarray(by_label[nearest], np.float32)


class _Views(NamedTuple):
    """One part in two frames or more of one class."""

    part: int
    mean: Floats32
    pictures: list[Floats32]
    slopes_px: Floats
    """(k, 2) by how much each frame shows it displaced, px of the patch per mm of height."""
    clipped: float
    """Grey level from which on a pixel may be saturated."""


def _parallax(seen: Sequence[_Views], inside: tuple[slice, slice]) -> tuple[Floats, Floats]:
    """Return how far above the plane of their patches n parts lie (n,), mm, and the inverses of the variances."""
    n, count = len(seen), np.array([len(one.pictures) for one in seen])
    starts, of = np.concatenate([[0], np.cumsum(count)[:-1]]), np.repeat(np.arange(n), count)
    means: Floats32 = np.stack([one.mean for one in seen])
    dy, dx = (np.asarray(v) for v in np.gradient(means, axis=(1, 2)))
    middle, gx, gy = (np.asarray(v[:, *inside], np.float32).reshape(n, -1) for v in (means, dx, dy))
    slopes = np.concatenate([one.slopes_px for one in seen])
    slopes = slopes - np.asarray(np.add.reduceat(slopes, starts) / count[:, None])[of]
    shown = np.stack([picture[inside] for one in seen for picture in one.pictures]).reshape(len(of), -1)
    rest = shown - middle[of]
    # Lamp and lens shade the views differently: gain, offset and a slope of the brightness say nothing of the height.
    at = np.indices(np.shape(means[0, *inside]), np.float32).reshape(2, -1)
    y, x = ((v - v.mean()) / max(float(np.ptp(v)), 1.0) for v in at)
    scaled = middle / np.maximum(middle.mean(1, keepdims=True), 1.0)
    columns = np.stack([np.ones_like(scaled), scaled, scaled * x, scaled * y, gx, gy], 1)
    clipped = np.array([[one.clipped] for one in seen], np.float32)
    if shown.max() >= clipped.min():
        # A saturated pixel differs between frames by light, not by place.
        usable = np.maximum.reduceat(shown, starts) < clipped
        rest, columns = rest * usable[of], columns * usable[:, None]
    normal = (columns @ columns.swapaxes(1, 2)).astype(np.float64)
    split = np.split(rest, starts[1:])
    along = np.concatenate([some @ own.T for some, own in zip(split, columns, strict=True)]).astype(np.float64)
    inverse = np.linalg.inv(normal[:, :4, :4] + 1e-6 * normal[:, :1, :1] * np.eye(4))
    shading = inverse @ normal[:, :4, 4:]
    gradients = normal[:, 4:, 4:] - normal[:, 4:, :4] @ shading
    found = along[:, 4:] - (along[:, None, :4] @ shading[of])[:, 0]
    unexplained = np.square(rest).sum(1) - np.einsum("vi,vij,vj->v", along[:, :4], inverse[of], along[:, :4])
    product = np.add.reduceat((slopes * found).sum(1), starts)
    squares = np.add.reduceat(slopes[:, :, None] * slopes[:, None], starts)
    power = np.maximum((squares * gradients).sum((1, 2)), 1e-9)
    # Noise has gradients, too: taken for texture, they would say that faint ground does not move between the frames.
    moves = np.split((slopes * (product / power)[of, None]).astype(np.float32), starts[1:])
    rest = np.concatenate([some - m @ own[4:] for some, m, own in zip(split, moves, columns, strict=True)])
    rough = rest.reshape(len(of), *np.shape(means[0, *inside]))
    steps = rough[:, :, 2:] - rough[:, :, :-2], rough[:, 2:] - rough[:, :-2]
    by_noise = sum(
        squares[:, k, k] * np.add.reduceat(np.square(step).sum((1, 2)), starts) / (4 * count * (count - 1))
        for k, step in enumerate(steps)
    )
    noise = (np.add.reduceat(unexplained, starts) - product**2 / power) / (count * middle.shape[1])
    # Larger differences than those of noise are those of a part far from the plane.
    by_noise = by_noise * np.minimum(_MOST_NOISE**2 / np.maximum(noise, 1e-9), 1)
    signal = np.maximum(power - by_noise, _LEAST_TEXTURE * power)
    off = -product / signal
    apart = np.maximum(squares[:, 0, 0] + squares[:, 1, 1], 1e-12)
    variance = 4 * np.maximum(noise, _LEAST_NOISE**2) * power / signal**2 + _MATRIX_PX**2 / apart
    return np.where(power > 1e-9, off, 0.0), np.where(power > 1e-9, 1 / variance, 0.0)
