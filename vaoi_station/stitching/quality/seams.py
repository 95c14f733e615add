"""Whether neighbouring cameras agree where they overlap, and why they do not.

If the links between two cameras are missing or contradict one another, the pixels of the overlap are tested for causes,
in this order: the board far off the calibrated plane; many saturated or black pixels, or much more brightness, in one
camera; corners so faint that noise alone prevents a link; the same picture at several places. A displaced camera is not
among them: the adjustment corrects it.

All cameras of a row are fired by one pulse. If their overlaps match when the row of one camera is changed by one, its
frames are in wrong rows (`acquisition.pairing.latency`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import USED, AdjustmentResult, Ints, Problem
from vaoi_station.stitching.matching.evidence import FrameKey, Links, Task
from vaoi_station.stitching.matching.frame_pair import FramePair, overlap_box
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.matching.link import choose_corners, find_shift, link_in_place

_LEAST_REJECTED, _MOSTLY_USED, _REJECTED_PX = 6, 0.5, 0.3
"""Least number of links of a seam from which most can be rejected, share of used ones, and residual of rejected links,
px, that shows that the cameras disagree."""
_SAME_HEIGHT_PX, _ALIKE_SHARE = 0.5, 0.6
"""Two heights of a component, by links across the seam and by others, agree up to this displacement at the seam, px;
least share of the corners in an overlap that is found again if both pictures are of one place."""
LIFT_LIMIT_MM = 2.0
"""Largest expected lift of a board: two standard deviations of its prior (`problem.SIGMA_MM`)."""
_HIGHEST_MM, _SAME_LIFT_MM, _SAME_LIFT_SHARE, _SIDEWAYS_PX = 12.0, 0.5, 0.15, 3.0
"""Largest lift that is searched in overlaps (mm); largest difference between two measurements of one lift, in mm and as
a share of it; largest shift of an overlap in the direction in which a lift has no effect (px)."""
_ROWS = 6
"""Number of rows that are examined: those with the most texture."""
_SATURATED, _BLACK, _CLIPPED_SHARE = 250, 1, 0.15
"""Grey levels from which on, and up to which, a pixel is saturated or black, and by how much its share in one camera
exceeds that in the other if the exposure is wrong."""
_BRIGHTNESS_RATIO = 2.5
"""Ratio of the brightness of two overlaps above which different exposure is named as the cause."""
_HALF_PX, _LINK_SCORE, _CLEAR_CORNERS = 12, 0.80, 8
"""Half the side of a patch, least correlation of a link, and least number of corners of an overlap with texture."""
_REPEATED, _APART_PX, _SEARCH_MM = 0.85, 8, 4.0
"""Least correlation of a repeated corner's patch with another place of the same frame, and least and largest distance
of that: the range in which a displaced camera is searched."""
_MOSTLY, _NEARLY_ALL = 0.5, 0.9
"""Share of repeated corners from which on a pattern repeats, and from which on links that agree show no displacement:
on ordinary boards, half of the corners resemble another place."""
_QUARTILE = 0.3186
"""Lower quartile of the absolute values of a normal distribution with standard deviation 1."""
_TRIED_ROWS, _AGREEING, _LINKS, _PLAINLY = 4, 2, 12, 2.0
"""Rows, of each pair of cameras, that are compared with the rows before and after them; number of these that must have
the same offset; least number of links of frames of one pulse, and their least ratio to the links without offset."""

Grey = NDArray[np.uint8]
Sides = tuple[float, float]
"""A value of the left and of the right camera."""


class Lift(NamedTuple):
    """The height of the board above the calibrated plane, and how it was measured."""

    mm: float
    overlaps: int | None = None
    """Number of overlaps that show this height; None if the height comes from the adjustment."""


class _Overlap(NamedTuple):
    """Measured values of the overlap of a row, or their means over several rows."""

    saturated: Sides
    black: Sides
    """Share of black pixels: the smaller of the share in the overlap and that in the whole frame."""
    brightness: Sides
    frame_brightness: Sides
    corners: float
    standing_out: Sides
    """Number of corners whose texture stands out of the noise, in each frame."""
    clear: float
    """Number of corners whose texture stands out of the noise in both frames."""
    repeated: float
    """Number of the clear corners whose patch the left frame shows at another place too."""


def seam_px(problem: Problem, adjusted: AdjustmentResult, at: Ints, least: int) -> float | None:
    """Return by how much two cameras disagree, px, by the links `at` between them; None if these do not show it.

    Links on components are left out, since their heights are no error of the seam, if `least` others are left. If
    nearly all lie on components, and most were rejected, the camera may have moved: all count across the lean.
    """
    bare = at[problem.component[at] < 0]
    if len(bare) >= least:
        return seam_offset_px(problem, adjusted, bare, least)
    if len(at) < _LEAST_REJECTED or (adjusted.weight[at] > USED).mean() > _MOSTLY_USED:
        return None
    across_px = seam_offset_px(problem, adjusted, at, len(at) + 1)
    return across_px if across_px > _REJECTED_PX else None


def seam_offset_px(problem: Problem, adjusted: AdjustmentResult, at: Ints, least: int) -> float:
    """Return the length of the median residual, px, of links between two cameras that lie beside components.

    Along the lean only links on the bare board count, if there are `least`: the others show heights.
    """
    o, off_px = problem.links, adjusted.link_px.take(at, axis=0)
    lean = o.b_lean.take(at, axis=0) - o.a_lean.take(at, axis=0)
    length = np.hypot(*lean.T)
    if not (length > 0).all():
        return float(np.hypot(*np.median(off_px, axis=0)))
    (x, y) = (lean / length[:, None]).T
    surely = problem.near[at] < 0 if len(problem.near) else np.ones(len(at), np.bool_)
    along, across = off_px[:, 0] * x + off_px[:, 1] * y, off_px[:, 1] * x - off_px[:, 0] * y
    shown = float(np.median(along[surely])) if surely.sum() >= least else 0.0
    return float(np.hypot(shown, np.median(across)))


def agreeing_links(problem: Problem, adjusted: AdjustmentResult, seam: Sequence[Links], left: int) -> int:
    """Return the number of used links that are evidence that camera `left` and the next one show the same place.

    On a component, its estimated height explains any residual across the seam. Such links count only if links from row
    to row give the same height, or if most corners of the overlap (`seam`, of all rows) are found again.
    """
    o, component = problem.links, problem.component
    used = (adjusted.weight > USED) & (o.seam == left)
    rows, between = adjusted.heights_mm
    if len(rows) and sum(len(e.a_px) for e in seam) < _ALIKE_SHARE * sum(e.tried for e in seam):
        off_px = np.abs(between - rows)[component] * np.hypot(*(o.b_lean - o.a_lean).T) * o.px_per_mm
        used &= (component < 0) | (off_px < _SAME_HEIGHT_PX)
    return int(used.sum())


def explain_seam(
    scene: Scene, links: Iterable[Links], pair: tuple[int, int], symptom: str, lift: Lift | None
) -> Reason:
    """Return a reason for two cameras that disagree: the symptom, followed by the cause that the tests found."""
    rows, mean = _examine(scene, links, pair[0])
    if mean is None:
        return Reason(ReasonCode.NOT_EXPLAINED, f"{symptom}: no row has good frames of both cameras to compare")
    code, text = _cause(pair, rows, mean, lift)
    return Reason(code, f"{symptom}: {text}")


def _cause(pair: tuple[int, int], rows: int, mean: _Overlap, lift: Lift | None) -> tuple[ReasonCode, str]:
    """Return the cause that the means over `rows` rows of an overlap show, as a code and in words."""
    if lift is not None and abs(lift.mm) > LIFT_LIMIT_MM:
        where, about = "above" if lift.mm > 0 else "below", "" if lift.overlaps is None else "about "
        # If there is only one overlap, a displacement of a camera shifts it in the same way as a lift.
        other = "; or one of the two cameras is displaced along the array by as much" if lift.overlaps == 1 else ""
        return ReasonCode.BOARD_OFF_PLANE, (
            f"the board lies {about}{abs(lift.mm):.1f} mm {where} the calibrated plane (limit {LIFT_LIMIT_MM:.0f} mm); "
            f"lay it into the calibrated plane, or calibrate at its height{other}"
        )
    for what, share in (("saturated", mean.saturated), ("black", mean.black)):
        k = int(np.argmax(share))
        if share[k] - share[1 - k] > _CLIPPED_SHARE:
            return ReasonCode.OVERLAP_EXPOSURE, (
                f"{share[k]:.0%} of the overlap is {what} in camera {pair[k]}, {share[1 - k]:.0%} in camera "
                f"{pair[1 - k]}; correct exposure, gain or light of camera {pair[k]}"
            )

    def enough(corners: float) -> bool:
        """Return whether a number of corners per row is that of an overlap with texture."""
        return corners * rows >= _CLEAR_CORNERS and corners >= _MOSTLY * mean.corners

    # Which camera is brighter, and by which factor: in the overlap, or in the whole frames if it is smaller there.
    over, frame = np.array(mean.brightness) + 1, np.array(mean.frame_brightness) + 1
    k = int(over.argmax())
    ratio = float(max(min(over[k] / over[1 - k], frame[k] / frame[1 - k]), 1))
    clear = f"{mean.clear * rows:.0f} of {mean.corners * rows:.0f} corners stand out"
    if not enough(mean.clear) and ratio > _BRIGHTNESS_RATIO:
        return ReasonCode.OVERLAP_EXPOSURE, (
            f"camera {pair[k]} shows the overlap {ratio:.1f} times as bright as camera {pair[1 - k]}, and the noise "
            f"hides its texture ({clear} in both); give both the same exposure, gain and light"
        )
    # An overlap with texture in one camera is not blank: the other camera shows another place, or something hides it.
    if not enough(mean.clear) and not any(map(enough, mean.standing_out)):
        return ReasonCode.OVERLAP_BLANK, (
            f"the overlap shows no texture beyond noise ({clear} in {rows} rows), so that nothing confirms where the "
            "two cameras are; if the board is not blank there, check light and focus"
        )
    if mean.repeated > _MOSTLY * mean.clear:
        return ReasonCode.OVERLAP_REPETITIVE, _repetitive(rows, mean)
    height = "" if lift is None else f", nor by height ({lift.mm:+.2f} mm)"
    return ReasonCode.NOT_EXPLAINED, (
        f"the two cameras do not show the same there; not explained by a displacement within ±{_SEARCH_MM:.0f} mm that "
        f"leaves an overlap, nor by exposure (brightness {ratio:.1f} : 1, {max(mean.saturated):.0%} saturated), nor by "
        f"missing texture ({clear} in both){height}; compare the frames of both"
    )


def _repetitive(rows: int, mean: _Overlap) -> str:
    return (
        f"the overlap shows a repeated pattern ({mean.repeated * rows:.0f} of {mean.corners * rows:.0f} corners fit at "
        "several places), so that nothing confirms where the two cameras are; use a reference, or a larger overlap"
    )


def repeated_overlap(scene: Scene, links: Iterable[Links], pair: tuple[int, int], symptom: str) -> Reason | None:
    """Return a reason if the overlap of two cameras shows a repeated pattern, otherwise None."""
    rows, mean = _examine(scene, links, pair[0])
    if mean is None or mean.clear < _CLEAR_CORNERS or mean.repeated <= _NEARLY_ALL * mean.clear:
        return None
    return Reason(ReasonCode.OVERLAP_REPETITIVE, f"{symptom}: {_repetitive(rows, mean)}")


def measure_lift(scene: Scene, links: Iterable[Links]) -> Lift | None:
    """Measure the height of the board above the calibrated plane from the shifts of the overlaps of calibrated cameras.

    A lift shifts all overlaps in one direction, a displaced camera those on its two sides in opposite ones. None if no
    overlap shows a lift, or if they show different ones.
    """
    links, each = tuple(links), []
    for left in range(len(scene.cameras) - 1):
        rows = _most_textured(_seam(links, left, scene))
        heights = [h for key in rows if (h := _lift_of_overlap(scene, key)) is not None]
        middle = float(np.median(heights)) if heights else 0.0
        if sum(_same_lift(h, middle) for h in heights) >= 2:
            each.append(middle)
    lift = float(np.median(each)) if each else 0.0
    return Lift(lift, len(each)) if each and all(_same_lift(h, lift) for h in each) else None


def _same_lift(a_mm: float, b_mm: float) -> bool:
    return abs(a_mm - b_mm) <= max(_SAME_LIFT_MM, _SAME_LIFT_SHARE * abs(b_mm))


def _at_rest(scene: Scene, left: FrameKey, right: FrameKey) -> FramePair:
    cameras = scene.cameras[left[0]], scene.cameras[right[0]]
    return FramePair(scene.prepared(left), scene.prepared(right), *cameras, np.zeros(2))


def _lift_of_overlap(scene: Scene, left: FrameKey) -> float | None:
    """Return the height (mm) at which a frame matches that of the next camera in their overlap; None if none."""
    pair = _at_rest(scene, left, (left[0] + 1, left[1]))
    a, b, box = pair.camera_a, pair.camera_b, pair.overlap()
    if box is None or a.working_distance_mm is None:
        return None
    middle = np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2])
    per_mm = b.project(a.ground(middle, 1.0), 1.0) - b.project(a.ground(middle), 0.0)
    found = find_shift(pair.a, pair.b, box, pair.offset_px(box), np.abs(per_mm) * _HIGHEST_MM + _SIDEWAYS_PX)
    if isinstance(found, Failure):
        return None
    height = float(found.px @ per_mm / (per_mm @ per_mm))
    return height if np.hypot(*(found.px - height * per_mm)) <= _SIDEWAYS_PX else None


def _seam(links: Iterable[Links], left: int, scene: Scene) -> list[Links]:
    present = {*scene.present}
    return [e for e in links if e.task.kind == "neighbours" and e.task.a[0] == left and e.task.b in present]


def _most_textured(seam: Iterable[Links], most: int = _ROWS) -> Iterator[FrameKey]:
    for e in sorted(seam, key=lambda e: (-e.tried, e.task.a))[:most]:
        yield e.task.a


def _examine(scene: Scene, links: Iterable[Links], left: int) -> tuple[int, _Overlap | None]:
    """Measure texture and grey levels in the overlap of two cameras; return the number of rows, and their means."""
    seam = _seam(links, left, scene)
    # If links failed in some rows, only these rows are examined.
    rows = _most_textured([e for e in seam if e.unmatched] or seam)
    seen = [overlap for key in rows if (overlap := _overlap(scene, key)) is not None]
    if not seen:
        return 0, None
    return len(seen), _Overlap(*(np.mean(values, 0) for values in zip(*seen, strict=True)))


def _overlap(scene: Scene, left: FrameKey) -> _Overlap | None:
    """Measure the overlap of a left frame with the next camera's frame of the same row; None if they do not overlap."""
    pair = _at_rest(scene, left, (left[0] + 1, left[1]))
    box, back = pair.overlap(), overlap_box(pair.camera_b, pair.camera_a, np.zeros(2))
    if box is None or back is None:
        return None
    a, b = pair.a, pair.b
    strips = [frame.grey[max(y0, 0) : y1, max(x0, 0) : x1] for frame, (x0, y0, x1, y1) in ((a, box), (b, back))]
    corners, noise = choose_corners(a, box), np.array([_noise_variance(strip) for strip in strips])
    places = pair.predict(corners.astype(np.float64)) if len(corners) else np.zeros((0, 2))
    variance = np.array(
        [[float(_patch(a.grey, p).var()), float(_patch(b.grey, q).var())] for p, q in zip(corners, places, strict=True)]
    ).reshape(-1, 2)
    share = np.maximum(1 - noise / np.maximum(variance, 1e-9), 0.0)
    # Noise reduces the correlation of two pictures of a patch to √(s₁·s₂), s being the share of texture in the
    # variance.
    clear = np.sqrt(share.prod(1)) >= _LINK_SCORE
    reach = round(_SEARCH_MM * pair.camera_a.px_per_mm)

    def both(values: Iterable[Any]) -> Sides:
        left_value, right_value = map(float, values)
        return left_value, right_value

    frames = list(zip(strips, (a.reduced(4), b.reduced(4)), strict=True))
    return _Overlap(
        both((strip >= _SATURATED).mean() for strip in strips),
        both(min((strip <= _BLACK).mean(), (whole <= _BLACK).mean()) for strip, whole in frames),
        both(strip.mean() for strip in strips),
        both(whole.mean() for _, whole in frames),
        len(corners),
        both((share >= _LINK_SCORE).sum(0)),
        int(clear.sum()),
        sum(_is_repeated(a.grey, corner, reach) for corner in corners[clear]),
    )


def _patch(grey: Grey, place: Floats | NDArray[np.int64]) -> Grey:
    """Cut the patch around a place (2,) px from a frame; near the border, the nearest patch inside the frame."""
    h, w = grey.shape
    x = int(np.clip(round(float(place[0])), _HALF_PX, w - _HALF_PX))
    y = int(np.clip(round(float(place[1])), _HALF_PX, h - _HALF_PX))
    return grey[y - _HALF_PX : y + _HALF_PX, x - _HALF_PX : x + _HALF_PX]


def _noise_variance(strip: Grey) -> float:
    """Estimate the variance of the noise (grey levels²) from second differences, in which smooth texture is small."""
    if min(strip.shape) < 3:
        return 0.0
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    rough = cv2.filter2D(strip, cv2.CV_32F, kernel)[1:-1, 1:-1]
    # Every overlap has places without texture. The lower quartile is taken to be one of them.
    return float(np.quantile(np.abs(rough), 0.25) / _QUARTILE / 6) ** 2 + 1 / 12


def _is_repeated(grey: Grey, corner: NDArray[np.int64], reach: int) -> bool:
    """Return whether the patch of a corner also appears at another place within `reach` px of the corner."""
    x, y = (int(v) for v in corner)
    x0, y0 = max(x - reach - _HALF_PX, 0), max(y - reach - _HALF_PX, 0)
    around, patch = grey[y0 : y + reach + _HALF_PX, x0 : x + reach + _HALF_PX], _patch(grey, corner)
    if min(around.shape) < 2 * _HALF_PX:
        return False
    score = np.nan_to_num(cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED))
    at_x, at_y = x - _HALF_PX - x0, y - _HALF_PX - y0
    score[max(at_y - _APART_PX, 0) : at_y + _APART_PX + 1, max(at_x - _APART_PX, 0) : at_x + _APART_PX + 1] = 0
    return bool(score.max() >= _REPEATED)


def row_offset(scene: Scene, links: Iterable[Links], left: int) -> int:
    """Return by how many rows (−1, 0, +1) the numbers of camera left + 1 are too high against those of camera left."""
    present = set(scene.present)
    seam = [e for e in links if e.task.kind == "neighbours" and e.task.a[0] == left and e.tried]
    votes, total = Counter[int](), Counter[int]()
    for _, row in _most_textured(seam, _TRIED_ROWS):
        counts = {}
        for offset in (-1, 0, 1):
            a, b = (left, row), (left + 1, row + offset)
            if b in present:
                counts[offset] = len(link_in_place(Task("neighbours", a, b), _at_rest(scene, a, b)).a_px)
        if counts:
            total.update(counts)
            best = max(counts, key=lambda offset: counts[offset])
            votes[best] += counts[best] > 0
    best = max((-1, 0, 1), key=lambda offset: total[offset])
    plainly = total[best] >= _LINKS and total[best] >= _PLAINLY * total[0] and votes[best] >= _AGREEING
    return best if plainly else 0


def shifted_cameras(offsets: Mapping[tuple[int, int], int], cameras: int) -> dict[int, int]:
    """Return for each camera with wrong row numbers by how many rows they are too high; most must be right."""
    place = [0]
    for i in range(cameras - 1):
        place.append(place[-1] + offsets.get((i, i + 1), 0))
    common, count = Counter(place).most_common(1)[0]
    # Of two cameras that disagree, it is not known which one is right.
    return {i: p - common for i, p in enumerate(place) if p != common} if 2 * count > cameras else {}
