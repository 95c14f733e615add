"""The cause why two neighbouring cameras do not show the same in their overlap, as far as the pictures support one.

Links fail, or contradict one another, for several causes. Each is tested with the pixels of the overlap:

- the board lies far from the calibrated plane: the estimated lift of its surface;
- exposure: saturated or black pixels, or very different brightness, in one of the two overlaps;
- no texture: the corners of the overlap are so faint that noise alone keeps their correlation below that of a link;
- a repeated pattern: corners that fit at several places, so that no displacement can be read from them.

If none of them holds, the reason says so, with the values that exclude them. A displacement is no cause in this list:
if it explains the links, the adjustment has corrected it, and the cameras agree.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.matching.coarse_search import find_shift
from vaoi_station.stitching.matching.evidence import FrameKey, Links
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.link import choose_corners
from vaoi_station.stitching.matching.overlap import Box, overlap_box
from vaoi_station.stitching.matching.scene import Scene

LIFT_LIMIT_MM = 2.0
"""Largest lift of a board that is expected: two standard deviations of its prior (`surface.SIGMA_MM`)."""
_HIGHEST_MM, _SAME_LIFT_MM, _SAME_LIFT_SHARE, _SIDEWAYS_PX = 12.0, 0.5, 0.15, 3.0
"""Range in which the lift is measured by the overlaps, largest difference (mm, or share) of two measurements of one
lift, and largest shift of an overlap in the direction in which heights shift nothing."""
_ROWS = 6
"""Number of rows that are examined: those with most texture."""
_SATURATED, _BLACK = 250, 1
"""Grey levels from which, and up to which, a pixel holds no texture."""
_CLIPPED_SHARE = 0.15
"""Least share of such pixels, beyond that of the other camera, that keeps an overlap from matching."""
_BRIGHTNESS_RATIO = 2.5
"""Ratio of the brightness of two overlaps from which on exposure is named as the cause."""
_HALF_PX = 12
"""Half the side of the patch around a corner, px."""
_LINK_SCORE = 0.80
"""Correlation that a link needs."""
_CLEAR_CORNERS = 8
"""Number of corners that stand out of the noise in both frames, from which on an overlap has texture."""
_REPEATED, _APART_PX, _SEARCH_MM = 0.85, 8, 4.0
"""Correlation of a corner with another place at least `_APART_PX` and at most `_SEARCH_MM` away that is a repetition.
The latter is the range in which a displaced camera is searched."""
_MOSTLY = 0.5
_NEARLY_ALL = 0.9
"""Share of repeated corners from which on agreeing links do not confirm a displacement. On ordinary boards, half of the
corners look like another place, and the rest decides."""
_QUARTILE = 0.3186
"""Lower quartile of the absolute values of a normal distribution with standard deviation 1."""

Grey = NDArray[np.uint8]


class _Overlap(NamedTuple):
    """What the overlap of one row shows: pairs of values are those of the left and of the right camera."""

    saturated: tuple[float, float]
    black: tuple[float, float]
    """Share of such pixels; of black ones the smaller of the shares in the overlap and in the whole frame."""
    brightness: tuple[float, float]
    """Mean grey level of the overlap."""
    frame_brightness: tuple[float, float]
    """Mean grey level of the whole frame."""
    corners: int
    standing_out: tuple[int, int]
    """Corners whose texture stands out of the noise of a frame."""
    clear: int
    """Corners whose texture stands out of the noise in both frames."""
    repeated: int
    """Clear corners that the left frame shows at another place too."""


class Lift(NamedTuple):
    """The height of the board above the calibrated plane, and how it was measured."""

    mm: float
    overlaps: int | None = None
    """Number of overlaps that were shifted by this height; None if the height is that of the adjustment."""


class _Evidence(NamedTuple):
    """What is known of two cameras that disagree, for the tests of causes."""

    names: tuple[str, str]
    lift: Lift | None
    rows: int
    mean: _Overlap
    """Means over the examined rows."""

    def share(self, number: float) -> str:
        """Return how many of the corners of all rows have a property, from the mean number per row."""
        return f"{number * self.rows:.0f} of {self.mean.corners * self.rows:.0f} corners"

    @property
    def textured(self) -> tuple[bool, bool]:
        """Whether the overlap shows texture in the left and in the right camera."""
        left, right = (self._enough(n) for n in self.mean.standing_out)
        return left, right

    @property
    def clear(self) -> bool:
        """Whether both cameras show texture at the same places."""
        return self._enough(self.mean.clear)

    def _enough(self, corners: float) -> bool:
        return corners * self.rows >= _CLEAR_CORNERS and corners >= _MOSTLY * self.mean.corners

    @property
    def brighter(self) -> tuple[int, float]:
        """The camera (0 or 1) that shows the overlap brighter, and the factor, which its whole frame confirms."""
        over, frame = np.array(self.mean.brightness) + 1, np.array(self.mean.frame_brightness) + 1
        k = int(over.argmax())
        return k, float(max(min(over[k] / over[1 - k], frame[k] / frame[1 - k]), 1))


Cause = tuple[ReasonCode, str]


def explain_seam(
    scene: Scene, links: Iterable[Links], pair: tuple[int, int], symptom: str, lift: Lift | None
) -> Reason:
    """Return the reason for two cameras that disagree: the symptom with the cause that the evidence supports.

    Args:
        scene: the frames of the run.
        links: the links of the run.
        pair: the two cameras, the left one first.
        symptom: how the two cameras disagree, as the beginning of a sentence.
        lift: height of the board above the calibrated plane; None if it is unknown.
    """
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
    """Measure the height of the board above the calibrated plane by the shifts of the overlaps; None if they differ.

    A lift shifts every overlap along the array, and all of them the same way. A displaced camera shifts the overlaps on
    its two sides in opposite ways. With one overlap alone, the two look alike.

    Args:
        scene: the frames of the run, with the cameras as calibrated.
        links: the links of the run, from which rows with texture in the overlap are chosen.
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
    """Return the height at which the overlap of a frame and that of the next camera fit; None if there is none."""
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
    """Return the reason that the overlap of two cameras shows a repeated pattern; None if it does not.

    Links on a repeated pattern agree at a place that is wrong by whole spacings, which looks like a displacement.
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
    # A displacement of one of two cameras shifts their only overlap alike.
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
    # Texture that only one of them shows is no blank overlap: the other shows another place, or something hides it.
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
    """Yield the left frames of the examined rows: those that did not match, or all, with most texture first."""
    seam = _seam(links, left, scene)
    return _most_textured([e for e in seam if e.unmatched] or seam)


def _seam(links: Iterable[Links], left: int, scene: Scene) -> list[Links]:
    present = {*scene.present}
    return [e for e in links if e.task.kind == "neighbours" and e.task.a[0] == left and e.task.b in present]


def _most_textured(seam: Iterable[Links]) -> Iterator[FrameKey]:
    for e in sorted(seam, key=lambda e: (-e.tried, e.task.a))[:_ROWS]:
        yield e.task.a


def _examine(scene: Scene, left: FrameKey) -> _Overlap | None:
    """Measure the overlap of a frame with that of the next camera in the same row; None if they have no overlap."""
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
        # Noise divides the correlation of a patch with itself by the root of its share in the variance of each frame.
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
    """Return the patch around a place (2,) of a frame, as far as the frame shows it."""
    h, w = grey.shape
    x = int(np.clip(round(float(place[0])), _HALF_PX, w - _HALF_PX))
    y = int(np.clip(round(float(place[1])), _HALF_PX, h - _HALF_PX))
    return grey[y - _HALF_PX : y + _HALF_PX, x - _HALF_PX : x + _HALF_PX]


def _noise_variance(strip: Grey) -> float:
    """Estimate the variance of the noise from second differences, which smooth texture leaves small."""
    if min(strip.shape) < 3:
        return 0.0
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    rough = cv2.filter2D(strip, cv2.CV_32F, kernel)[1:-1, 1:-1]
    # The lower quartile is that of places without texture, of which every overlap has some.
    return float(np.quantile(np.abs(rough), 0.25) / _QUARTILE / 6) ** 2 + 1 / 12


def _is_repeated(grey: Grey, corner: NDArray[np.int64], reach: int) -> bool:
    """Return whether the surroundings of a corner show its patch at another place too."""
    x, y = (int(v) for v in corner)
    x0, y0 = max(x - reach - _HALF_PX, 0), max(y - reach - _HALF_PX, 0)
    around, patch = grey[y0 : y + reach + _HALF_PX, x0 : x + reach + _HALF_PX], _patch(grey, corner)
    if min(around.shape) < 2 * _HALF_PX:
        return False
    score = np.nan_to_num(cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED))
    at_x, at_y = x - _HALF_PX - x0, y - _HALF_PX - y0
    score[max(at_y - _APART_PX, 0) : at_y + _APART_PX + 1, max(at_x - _APART_PX, 0) : at_x + _APART_PX + 1] = 0
    return bool(score.max() >= _REPEATED)
