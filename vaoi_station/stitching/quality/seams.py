"""Find cameras whose frames are in wrong rows: their overlaps match when the row of one camera is changed by one.

All cameras of a row are fired by one pulse, so neighbouring cameras show the same part of the board in the same row. If
they do not, either a camera has moved, or the frames of a camera are assigned to the row before or after
(`acquisition.pairing.latency`). In the second case, the overlap in row j of one camera matches row j ± 1 of the other
camera at the place that the calibration predicts. A moved camera would show this only if it had moved by exactly one
step of the belt.

Find out why two neighbouring cameras show different pictures of their overlap, and state the cause.

If the links between two cameras are missing or contradict one another, the pixels of the overlap are tested for these
causes, in this order:

- off plane: the board lies far above or below the calibrated plane;
- exposure: one camera shows many saturated or black pixels there, or one is much brighter than the other;
- no texture: the corners in the overlap are so faint that noise alone prevents a link;
- repeated pattern: the same picture appears at several places, so that links cannot show a displacement.

If no test succeeds, the reason states so, together with the measured values. A displaced camera is not among the
causes: the adjustment corrects it wherever links show it, and the cameras then agree.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Ints, Problem
from vaoi_station.stitching.matching.evidence import FrameKey, Links, Task
from vaoi_station.stitching.matching.frame_pair import Box, FramePair, overlap_box
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.matching.link import choose_corners, find_shift, link_in_place

LIFT_LIMIT_MM = 2.0
"""Largest expected lift of a board: two standard deviations of its prior (`surface.SIGMA_MM`)."""
_HIGHEST_MM, _SAME_LIFT_MM, _SAME_LIFT_SHARE, _SIDEWAYS_PX = 12.0, 0.5, 0.15, 3.0
"""Limits for the measurement of the lift from overlaps.

In this order: the largest lift that is searched (mm); the largest difference between two measurements of the same lift,
in mm and as a share of the lift; and the largest shift of an overlap in the direction in which a lift has no effect
(px)."""
_ROWS = 6
"""Number of rows that are examined: those with the most texture."""
_SATURATED, _BLACK = 250, 1
"""A pixel with this grey level or more is saturated; one with this grey level or less is black."""
_CLIPPED_SHARE = 0.15
"""A camera's exposure is wrong if its share of saturated or black pixels exceeds that of the other camera by this."""
_BRIGHTNESS_RATIO = 2.5
"""Ratio of the brightness of two overlaps above which different exposure is named as the cause."""
_HALF_PX = 12
"""Half the side of the patch around a corner, px."""
_LINK_SCORE = 0.80
"""Least correlation of a link."""
_CLEAR_CORNERS = 8
"""Least number of corners that stand out of the noise in both frames, for an overlap to count as textured."""
_REPEATED, _APART_PX, _SEARCH_MM = 0.85, 8, 4.0
"""A corner is repeated if its patch has at least the correlation `_REPEATED` with another place of the same frame.

That place lies at least `_APART_PX` and at most `_SEARCH_MM` away: the range in which a displaced camera is
searched."""
_MOSTLY = 0.5
_NEARLY_ALL = 0.9
"""Share of repeated corners above which links that agree are no evidence of a displacement.

On ordinary boards, half of the corners resemble another place; the other half then shows the true displacement."""
_QUARTILE = 0.3186
"""Lower quartile of the absolute values of a normal distribution with standard deviation 1."""

_LEAST_REJECTED, _USED, _MOSTLY_USED, _REJECTED_PX = 6, 0.1, 0.5, 0.3
"""Least number of links of a seam from which most can be rejected, weight above which one is used, their share, and the
residual of rejected links, px, that shows that the cameras disagree; a smaller one shows nothing."""
_SAME_HEIGHT_PX, _ALIKE_SHARE = 0.5, 0.6
"""Two heights of a component, by links across the seam and by others, agree up to this displacement at the seam, px.

If at least the share `_ALIKE_SHARE` of the corners in an overlap is found again, both pictures are of one place."""

Grey = NDArray[np.uint8]


class _Overlap(NamedTuple):
    """Measured values of the overlap in one row. Pairs hold the values of the left and of the right camera."""

    saturated: tuple[float, float]
    black: tuple[float, float]
    """Share of black pixels: the smaller of the share in the overlap and that in the whole frame."""
    brightness: tuple[float, float]
    """Mean grey level of the overlap."""
    frame_brightness: tuple[float, float]
    """Mean grey level of the whole frame."""
    corners: int
    standing_out: tuple[int, int]
    """Number of corners whose texture stands out of the noise, in each frame."""
    clear: int
    """Number of corners whose texture stands out of the noise in both frames."""
    repeated: int
    """Number of the clear corners whose patch the left frame shows at another place too."""


class Lift(NamedTuple):
    """The height of the board above the calibrated plane, and how it was measured."""

    mm: float
    overlaps: int | None = None
    """Number of overlaps that show this height; None if the height comes from the adjustment."""


class _Evidence(NamedTuple):
    """Measured values about two cameras that disagree, as the input of the tests for causes."""

    names: tuple[str, str]
    lift: Lift | None
    rows: int
    mean: _Overlap
    """Means of the measured values over the examined rows."""

    def share(self, number: float) -> str:
        """Return the words "n of m corners" for all examined rows, from the mean number per row."""
        return f"{number * self.rows:.0f} of {self.mean.corners * self.rows:.0f} corners"

    @property
    def textured(self) -> tuple[bool, bool]:
        """Whether the overlap shows texture in the picture of the left camera, and in that of the right camera."""
        left, right = (self._enough(n) for n in self.mean.standing_out)
        return left, right

    @property
    def clear(self) -> bool:
        """Whether both cameras show enough corners with texture at the same places."""
        return self._enough(self.mean.clear)

    def _enough(self, corners: float) -> bool:
        return corners * self.rows >= _CLEAR_CORNERS and corners >= _MOSTLY * self.mean.corners

    @property
    def brighter(self) -> tuple[int, float]:
        """Which camera (0: left, 1: right) shows the overlap brighter, and by which factor, at least 1.

        If the ratio of the brightness of the whole frames is smaller than that in the overlap, it is the factor.
        """
        over, frame = np.array(self.mean.brightness) + 1, np.array(self.mean.frame_brightness) + 1
        k = int(over.argmax())
        return k, float(max(min(over[k] / over[1 - k], frame[k] / frame[1 - k]), 1))


Cause = tuple[ReasonCode, str]


def explain_seam(
    scene: Scene, links: Iterable[Links], pair: tuple[int, int], symptom: str, lift: Lift | None
) -> Reason:
    """Return a reason for two cameras that disagree: the symptom, followed by the cause that the tests found."""
    evidence = _gather(scene, links, pair, lift)
    if evidence is None:
        nothing = "no row has good frames of both cameras to compare"
        return Reason(ReasonCode.NOT_EXPLAINED, f"{symptom}: {nothing}")
    code, text = (
        _off_plane(evidence)
        or _clipped(evidence)
        or _faint(evidence)
        or _repetitive(evidence)
        or _unexplained(evidence)
    )
    return Reason(code, f"{symptom}: {text}")


def measure_lift(scene: Scene, links: Iterable[Links]) -> Lift | None:
    """Measure the height of the board above the calibrated plane from the shifts of the overlaps.

    A lift shifts all overlaps along the array in the same direction. A displaced camera shifts the overlaps on its two
    sides in opposite directions. With one overlap alone, the two cases cannot be distinguished.

    Args:
        scene: the frames of the run, with the cameras as calibrated.
        links: the links of the run, by which rows with texture in the overlap are chosen.

    Returns:
        The lift; None if no overlap shows one, or if the overlaps show different ones.
    """
    links = tuple(links)
    each = []
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


def _lift_of_overlap(scene: Scene, left: FrameKey) -> float | None:
    """Return the height (mm) at which a frame matches that of the next camera in their overlap; None if none."""
    right = left[0] + 1, left[1]
    a, b = scene.cameras[left[0]], scene.cameras[right[0]]
    pair = FramePair(scene.prepared(left), scene.prepared(right), a, b, np.zeros(2))
    box = pair.overlap()
    if box is None or a.working_distance_mm is None:
        return None
    middle = np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2])
    per_mm = b.project(a.ground(middle, 1.0), 1.0) - b.project(a.ground(middle), 0.0)
    found = find_shift(pair.a, pair.b, box, pair.offset_px(box), np.abs(per_mm) * _HIGHEST_MM + _SIDEWAYS_PX)
    if isinstance(found, Failure):
        return None
    height = float(found.px @ per_mm / (per_mm @ per_mm))
    return height if np.hypot(*(found.px - height * per_mm)) <= _SIDEWAYS_PX else None


def repeated_overlap(scene: Scene, links: Iterable[Links], pair: tuple[int, int], symptom: str) -> Reason | None:
    """Return a reason if the overlap of two cameras shows a repeated pattern, otherwise None.

    Links on a repeated pattern can agree with one another at a wrong place, off by whole periods of the pattern. This
    looks like a displacement of a camera.
    """
    evidence = _gather(scene, links, pair, None)
    if evidence is None or evidence.mean.clear < _CLEAR_CORNERS:
        return None
    if evidence.mean.repeated <= _NEARLY_ALL * evidence.mean.clear:
        return None
    cause = _repetitive(evidence)
    return None if cause is None else Reason(cause[0], f"{symptom}: {cause[1]}")


def _gather(scene: Scene, links: Iterable[Links], pair: tuple[int, int], lift: Lift | None) -> _Evidence | None:
    """Measure texture and grey levels in the overlap of two cameras; None if no row has good frames of both."""
    seen = [overlap for key in _rows(links, pair[0], scene) if (overlap := _examine(scene, key)) is not None]
    if not seen:
        return None
    mean = _Overlap(*(np.mean([o[k] for o in seen], 0) for k in range(len(_Overlap._fields))))
    return _Evidence((f"camera {pair[0]}", f"camera {pair[1]}"), lift, len(seen), mean)


def _off_plane(e: _Evidence) -> Cause | None:
    if e.lift is None or abs(e.lift.mm) <= LIFT_LIMIT_MM:
        return None
    where = "above" if e.lift.mm > 0 else "below"
    about = "" if e.lift.overlaps is None else "about "
    # If there is only one overlap, a displacement of a camera shifts it in the same way as a lift.
    other = "; or one of the two cameras is displaced along the array by as much" if e.lift.overlaps == 1 else ""
    return ReasonCode.BOARD_OFF_PLANE, (
        f"the board lies {about}{abs(e.lift.mm):.1f} mm {where} the calibrated plane (limit {LIFT_LIMIT_MM:.0f} mm); "
        f"lay it into the calibrated plane, or calibrate at its height{other}"
    )


def _clipped(e: _Evidence) -> Cause | None:
    for what, share in (("saturated", e.mean.saturated), ("black", e.mean.black)):
        k = int(np.argmax(share))
        if share[k] - share[1 - k] > _CLIPPED_SHARE:
            return ReasonCode.OVERLAP_EXPOSURE, (
                f"{share[k]:.0%} of the overlap is {what} in {e.names[k]}, {share[1 - k]:.0%} in {e.names[1 - k]}; "
                f"correct exposure, gain or light of {e.names[k]}"
            )
    return None


def _faint(e: _Evidence) -> Cause | None:
    if e.clear:
        return None
    k, ratio = e.brighter
    if ratio > _BRIGHTNESS_RATIO:
        return ReasonCode.OVERLAP_EXPOSURE, (
            f"{e.names[k]} shows the overlap {ratio:.1f} times as bright as {e.names[1 - k]}, and the noise hides its "
            f"texture ({e.share(e.mean.clear)} stand out in both); give both the same exposure, gain and light"
        )
    # An overlap with texture in one camera is not blank: the other camera shows another place, or something hides it.
    if any(e.textured):
        return None
    return ReasonCode.OVERLAP_BLANK, (
        f"the overlap shows no texture beyond noise ({e.share(e.mean.clear)} stand out in {e.rows} rows), so that "
        "nothing confirms where the two cameras are; if the board is not blank there, check light and focus"
    )


def _repetitive(e: _Evidence) -> Cause | None:
    if e.mean.repeated <= _MOSTLY * e.mean.clear:
        return None
    return ReasonCode.OVERLAP_REPETITIVE, (
        f"the overlap shows a repeated pattern ({e.share(e.mean.repeated)} fit at several places), so that nothing "
        "confirms where the two cameras are; use a reference, or a larger overlap"
    )


def _unexplained(e: _Evidence) -> Cause:
    height = "" if e.lift is None else f", nor by height ({e.lift.mm:+.2f} mm)"
    return ReasonCode.NOT_EXPLAINED, (
        f"the two cameras do not show the same there; not explained by a displacement within ±{_SEARCH_MM:.0f} mm that "
        f"leaves an overlap, nor by exposure (brightness {e.brighter[1]:.1f} : 1, {max(e.mean.saturated):.0%} "
        f"saturated), nor by missing texture ({e.share(e.mean.clear)} stand out in both){height}; compare the frames "
        "of both"
    )


def _rows(links: Iterable[Links], left: int, scene: Scene) -> Iterator[FrameKey]:
    """Yield the left frames of the rows to examine, those with most texture first.

    If links failed in some rows, only these rows are examined.
    """
    seam = _seam(links, left, scene)
    return _most_textured([e for e in seam if e.unmatched] or seam)


def _seam(links: Iterable[Links], left: int, scene: Scene) -> list[Links]:
    present = {*scene.present}
    return [e for e in links if e.task.kind == "neighbours" and e.task.a[0] == left and e.task.b in present]


def _most_textured(seam: Iterable[Links]) -> Iterator[FrameKey]:
    for e in sorted(seam, key=lambda e: (-e.tried, e.task.a))[:_ROWS]:
        yield e.task.a


def _examine(scene: Scene, left: FrameKey) -> _Overlap | None:
    """Measure the overlap of a left frame with the next camera's frame of the same row; None if they do not overlap."""
    right = left[0] + 1, left[1]
    a, b = scene.prepared(left), scene.prepared(right)
    cameras = scene.cameras[left[0]], scene.cameras[right[0]]
    pair = FramePair(a, b, *cameras, np.zeros(2))
    box, back = pair.overlap(), overlap_box(cameras[1], cameras[0], np.zeros(2))
    if box is None or back is None:
        return None
    strips = _cut(a.grey, box), _cut(b.grey, back)
    noise = [_noise_variance(strip) for strip in strips]
    corners = choose_corners(a, box)
    standing_out, clear, repeated = [0, 0], 0, 0
    reach = round(_SEARCH_MM * cameras[0].px_per_mm)
    for corner, place in zip(corners, pair.predict(corners.astype(np.float64)) if len(corners) else (), strict=True):
        patches = _patch(a.grey, corner), _patch(b.grey, place)
        share = [max(1 - n / max(float(p.var()), 1e-9), 0.0) for n, p in zip(noise, patches, strict=True)]
        for k in (0, 1):
            standing_out[k] += share[k] >= _LINK_SCORE
        # Noise reduces the correlation of two pictures of a patch to √(s₁·s₂), s being the share of texture in the
        # variance.
        if np.sqrt(share[0] * share[1]) >= _LINK_SCORE:
            clear += 1
            repeated += _is_repeated(a.grey, corner, reach)
    frames = a.quarter, b.quarter
    return _Overlap(
        _both(float((strip >= _SATURATED).mean()) for strip in strips),
        _both(min(float((g <= _BLACK).mean()) for g in of_camera) for of_camera in zip(strips, frames, strict=True)),
        _both(float(strip.mean()) for strip in strips),
        _both(float(frame.mean()) for frame in frames),
        len(corners),
        (standing_out[0], standing_out[1]),
        clear,
        repeated,
    )


def _both(values: Iterable[float]) -> tuple[float, float]:
    left, right = values
    return left, right


def _cut(grey: Grey, box: Box) -> Grey:
    x0, y0, x1, y1 = box
    return grey[max(y0, 0) : y1, max(x0, 0) : x1]


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


def seam_offset_px(problem: Problem, adjusted: AdjustmentResult, at: Ints, least: int) -> float:
    """Return the length of the median residual, px, of links between two cameras that lie beside components.

    A link whose patch reaches a component may lie on its side. Its residual along the lean then shows the height of the
    side, not an error of the seam. Only links on the bare board count along the lean, and only if there are enough.

    Args:
        problem: the problem of the adjustment.
        adjusted: its solution.
        at: indices of the links.
        least: least number of links on the bare board that show an offset along the lean.
    """
    o, off_px = problem.links, adjusted.link_px[at]
    lean = o.b_lean[at] - o.a_lean[at]
    length = np.hypot(*lean.T)
    if not (length > 0).all():
        return float(np.hypot(*np.median(off_px, axis=0)))
    (x, y), surely = (lean / length[:, None]).T, ~problem.reaches_component[at]
    along, across = off_px[:, 0] * x + off_px[:, 1] * y, off_px[:, 1] * x - off_px[:, 0] * y
    shown = float(np.median(along[surely])) if surely.sum() >= least else 0.0
    return float(np.hypot(shown, np.median(across)))


def agreeing_links(problem: Problem, adjusted: AdjustmentResult, seam: Sequence[Links], left: int) -> int:
    """Return the number of used links that are evidence that camera `left` and the next one show the same place.

    On a component, its estimated height explains any residual across the seam. Such links count only if links from row
    to row give the same height, or if most corners of the overlap are found again.

    Args:
        problem: the problem of the adjustment.
        adjusted: its solution.
        seam: the evidence of the two cameras, from all rows.
        left: the lower number of the two cameras.
    """
    o, component = problem.links, problem.component
    used = (adjusted.weight > _USED) & (o.seam == left)
    rows, between = adjusted.heights_mm
    alike = sum(len(e.a_px) for e in seam) >= _ALIKE_SHARE * sum(e.tried for e in seam)
    if len(rows) and not alike:
        off_px = np.abs(between - rows)[component] * np.hypot(*(o.b_lean - o.a_lean).T) * o.px_per_mm
        used &= (component < 0) | (off_px < _SAME_HEIGHT_PX)
    return int(used.sum())


def seam_px(problem: Problem, adjusted: AdjustmentResult, at: Ints, least: int) -> float | None:
    """Return by how much two cameras disagree, px; None if their links do not show it.

    Links on components are left out, since the height of a component is no error of the seam. If nearly all links lie
    on components, and most links were rejected, the camera may have moved by pixels: without links on the bare board,
    their noise floor is not widened. Then all of them count, across the lean, to which heights do not contribute.

    Args:
        problem: the problem of the adjustment.
        adjusted: its solution.
        at: indices of all links between the two cameras.
        least: least number of links on the bare board.
    """
    bare = at[problem.component[at] < 0]
    if len(bare) >= least:
        return seam_offset_px(problem, adjusted, bare, least)
    if len(at) < _LEAST_REJECTED or (adjusted.weight[at] > _USED).mean() > _MOSTLY_USED:
        return None
    across_px = seam_offset_px(problem, adjusted, at, len(at) + 1)
    return across_px if across_px > _REJECTED_PX else None


_TRIED_ROWS = 4
"""Number of rows, for each pair of cameras, that are compared with the rows before and after them."""
_AGREEING = 2
"""Number of the compared rows in which most links must have the same offset."""
_PLAINLY = 2.0
"""Least ratio of the number of links at the offset to the number of links without offset."""
_LINKS = 12
"""Least number of links, in all compared rows together, by which frames count as frames of the same pulse."""
_AT_REST = np.zeros(2)


def row_offset(scene: Scene, links: Iterable[Links], left: int) -> int:
    """Return by how many rows (−1, 0, +1) the row numbers of camera left + 1 are too high against those of camera left.

    Args:
        scene: the frames of the run.
        links: the links of the run, by which rows with texture in the overlap are chosen.
        left: the lower number of the two cameras.
    """
    present = set(scene.present)
    seam = [e for e in links if e.task.kind == "neighbours" and e.task.a[0] == left and e.tried]
    # Rows with most texture in the overlap decide best.
    votes, total = Counter[int](), Counter[int]()
    for e in sorted(seam, key=lambda e: (-e.tried, e.task.a))[:_TRIED_ROWS]:
        row = e.task.a[1]
        counts = {
            offset: _count_links(scene, (left, row), (left + 1, row + offset))
            for offset in (-1, 0, 1)
            if (left + 1, row + offset) in present
        }
        if not counts:
            continue
        total.update(counts)
        best = max(counts, key=lambda offset: counts[offset])
        votes[best] += counts[best] > 0
    best = max((-1, 0, 1), key=lambda offset: total[offset])
    plainly = total[best] >= _LINKS and total[best] >= _PLAINLY * total[0] and votes[best] >= _AGREEING
    return best if plainly else 0


def shifted_cameras(offsets: Mapping[tuple[int, int], int], cameras: int) -> dict[int, int]:
    """Return, for each camera with wrong row numbers, by how many rows they are too high; most cameras must be right.

    Args:
        offsets: for a pair of neighbouring cameras, the offset of the second against the first; 0 for pairs not listed.
        cameras: number of cameras.
    """
    place = [0]
    for i in range(cameras - 1):
        place.append(place[-1] + offsets.get((i, i + 1), 0))
    common, count = Counter(place).most_common(1)[0]
    # Of two cameras that disagree, it is not known which one is right.
    return {i: p - common for i, p in enumerate(place) if p != common} if 2 * count > cameras else {}


def _count_links(scene: Scene, a: FrameKey, b: FrameKey) -> int:
    """Count the links that are found between two frames if they are taken as frames of the same pulse."""
    cameras = scene.cameras[a[0]], scene.cameras[b[0]]
    pair = FramePair(scene.prepared(a), scene.prepared(b), *cameras, _AT_REST)
    return len(link_in_place(Task("neighbours", a, b), pair).a_px)
