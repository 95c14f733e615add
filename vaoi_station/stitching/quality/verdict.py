"""The verdict on a stitch, ok, degraded or failed, decided by a list of checks of its findings.

A result is ok if every position has a standard deviation of at most 0.2 px, each component is seen as much as is asked
for, and no check fails. It is degraded if it is usable but a check fails; the reasons name the check, in words and
numbers. It is failed if it contains no component positions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode, Status
from vaoi_station.stitching.adjustment.problem import USED, FiducialPoints, Influence, Ints
from vaoi_station.stitching.adjustment.row_motion import board_texture
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping
from vaoi_station.stitching.board.fiducials import outside_share
from vaoi_station.stitching.components.bad_boards import board_reasons, mark_reasons
from vaoi_station.stitching.components.centres import component_reasons
from vaoi_station.stitching.components.other_type import (
    compare_components,
    find_unlisted_parts,
    shown_by_points,
    unlisted_part_reasons,
)
from vaoi_station.stitching.quality.agreement import (
    common_local_reasons,
    fiducial_reasons,
    outline_reasons,
    reference_reasons,
    uncertain_detections,
    wrong_size,
)
from vaoi_station.stitching.quality.confirmation import dark_light_reasons
from vaoi_station.stitching.quality.findings import DISPLACED_PX, SEAM_LIMIT_PX, Findings
from vaoi_station.stitching.quality.pictures import blur_reasons, camera_blurs, lens_reasons
from vaoi_station.stitching.quality.seams import explain_seam, repeated_overlap, shifted_cameras
from vaoi_station.stitching.quality.uncertainty import uncertain_calibration
from vaoi_station.stitching.quality.visibility import absent_camera_reasons, unconfirmed_reasons, unseen_reasons

_FLOOR_LIMIT_PX, _UNEXPLAINED_PX, _UNEXPLAINED = 0.30, 0.15, 3.0
"""Largest scatter of links beyond image noise: in any case, and if it exceeds the image noise by the last factor.

Scatter that noise does not explain comes from links that do not move with the board, for example on a belt as bright as
the board (seed 108935). Of 3191 drawings that were `ok`, no other one had more than 0.15 px and three times the noise.
"""


def unconnected_rows(f: Findings) -> Iterator[Reason]:
    """Yield a reason for rows that no links connect with the others."""
    if f.unplaced:
        yield from _unplaced_rows(f)
        return
    groups = _groups_of_rows(f)
    if len(groups) < 2:
        return
    parts = ", ".join(f"{g.min()}–{g.max()}" for g in groups)
    unlinked = f"no links connect the rows {parts} with one another: the belt's nominal speed gives their distance"
    ends = [(int(a.max()), int(b.min())) for a, b in pairwise(groups)]
    lost = [row for last, first in ends for row in range(last + 1, first) if not f.placed[row]]
    if not lost:
        yield Reason(ReasonCode.ROWS_NOT_CONNECTED, unlinked)
        return
    yield Reason(
        ReasonCode.ROWS_LOST,
        f"no camera delivered a good frame of row{'s' if len(lost) > 1 else ''} {', '.join(map(str, lost))}, and "
        f"{unlinked}. Fiducials on both sides of the gap may not fit together for that reason: repair what lost these "
        "frames and film the board again",
    )


def _groups_of_rows(f: Findings) -> list[Ints]:
    """Return the groups of rows between which there is no connection by links or marks."""
    if len(f.connected_groups) > 1:
        return f.connected_groups
    # A single row without links to other rows is in no group.
    o, points = f.problem.links, f.problem.fiducials
    seen, placed = np.append(o.p, o.q), np.flatnonzero(f.placed)
    marked = points.row if points is not None else np.zeros(0, dtype=np.int_)
    for last, first in pairwise(placed.tolist()):
        sides = [((rows <= last).any(), (rows >= first).any()) for rows in (seen, marked)]
        spanned = ((o.p <= last) & (o.q >= first) | (o.q <= last) & (o.p >= first)).any()
        if first > last + 1 and not spanned and all(sides[0]) and not all(sides[1]):
            return [placed[placed <= last], placed[placed >= first]]
    return f.connected_groups


def _unplaced_rows(f: Findings) -> Iterator[Reason]:
    """Yield a reason for the rows without known position; rows at the board's ends that hardly show it do not count."""
    if not f.unseen and not any(set(f.unplaced) & set(g.tolist()) for g in f.connected_groups):
        return
    rows = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in _ranges(f.unplaced))
    unlinked = (
        f"no links connect the rows {rows} with the rows in which the board is placed: how far the belt moved "
        "in between is not known, and these rows have no matrices and no views"
    )
    lost = [row for row, placed in enumerate(f.placed) if not placed and row not in f.unplaced]
    if not lost:
        yield Reason(ReasonCode.ROWS_NOT_CONNECTED, f"{unlinked}. Check the belt, and film the board again")
        return
    yield Reason(
        ReasonCode.ROWS_LOST,
        f"no camera delivered a good frame of row{'s' if len(lost) > 1 else ''} {', '.join(map(str, lost))}, and "
        f"{unlinked}: repair what lost these frames and film the board again",
    )


def _ranges(rows: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the first and the last row of each group of consecutive rows."""
    ends = [(a, b) for a, b in pairwise(rows) if b > a + 1]
    return list(zip((rows[0], *(b for _, b in ends)), (*(a for a, _ in ends), rows[-1]), strict=True))


def rows_apart(f: Findings) -> list[list[int]]:
    """Return the groups of rows whose distance from the other rows is uncertain by periods of a repeated pattern.

    A group that shows a fiducial is certain: a motion that is wrong by a period would displace that fiducial. If no
    row shows one, all groups are returned.
    """
    cuts = {(e.task.a[1], e.task.b[1]) for e in f.links if e.ambiguous and e.task.b is not None}
    rows = sorted({row for _, row in f.scene.present})
    if not cuts & set(pairwise(rows)):
        return []
    points = f.problem.fiducials
    marked = set(points.row.tolist()) if points is not None else set()
    groups = [[rows[0]]]
    for p, q in pairwise(rows):
        if (p, q) in cuts:
            groups.append([])
        groups[-1].append(q)
    return [group for group in groups if not marked & set(group)]


def repeated_rows(f: Findings) -> Iterator[Reason]:
    """Yield a reason for rows whose motion against the others a repeated pattern leaves open and no mark confirms."""
    unsure = [row for group in rows_apart(f) for row in group]
    if unsure:
        named = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in _ranges(tuple(unsure)))
        yield Reason(
            ReasonCode.ROWS_REPETITIVE,
            f"a repeated pattern connects the rows {named} with the others at several motions of the belt, and no "
            "fiducial in these rows decides between them: the motion nearest to the nominal speed is used; use a "
            "reference, or fiducials that every row shows",
        )


def scattered_links(f: Findings) -> Iterator[Reason]:
    """Yield a reason if the links between rows scatter by more than noise explains."""
    links, floor = f.problem.links, f.adjusted.floor_px
    noise = links.median_noise_px(np.flatnonzero((f.adjusted.weight > USED) & (links.p != links.q)))
    if floor > _FLOOR_LIMIT_PX:
        scatter = f"links scatter by {floor:.2f} px (limit {_FLOOR_LIMIT_PX})"
        yield Reason(ReasonCode.LINKS_SCATTER, f"{scatter}: the board is not rigid or flat")
    elif floor > max(_UNEXPLAINED_PX, _UNEXPLAINED * noise):
        yield Reason(
            ReasonCode.LINKS_SCATTER,
            f"links scatter by {floor:.2f} px, of which image noise explains {noise:.2f} px (limit {_UNEXPLAINED_PX}): "
            "what the frames show does not move as one board; use a belt or carrier that is darker or brighter than "
            "the board's edge, and check that the board is rigid",
        )


def disputed_positions(f: Findings, limit_px: float) -> str:
    """Return clauses that name what decides positions by more than noise explains; empty if nothing does.

    These are positions that would be known better than `limit_px` if the links of all places, and all marks, agreed.
    """
    influence = f.adjusted.influence
    rows = _uncertain_by(f, influence, limit_px)
    if influence is None or not rows:
        return ""
    of_marks = influence.of_marks
    marks, places = (_uncertain_by(f, influence.select(at), limit_px) for at in (of_marks, ~of_marks))
    clauses = ""
    if marks or not places:
        clauses += (
            "; without one of the marks that place the board (fiducials, fixture, reference) positions move by more "
            "than noise explains: these marks contradict one another. Check whether a mark is dirty or covered, and "
            "compare the marks in the board type with the board"
        )
    if places or not marks:
        named = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in _ranges(tuple(places or rows)))
        clauses += (
            f"; positions in row{'s' if len(places or rows) > 1 else ''} {named} follow from few places of the "
            "pictures, and without one of these they move by more than noise explains: it may show the belt, a shadow, "
            "or a part that the board type lacks. Let consecutive frames overlap more (a slower belt or a shorter "
            "period), and keep belt and carrier darker or brighter than the board's edge"
        )
    return clauses


def _uncertain_by(f: Findings, influence: Influence | None, limit_px: float) -> list[int]:
    """Return the rows with positions that have a standard deviation above a limit only on account of an influence."""
    if influence is None or f.mapping is None:
        return []
    with_it, without = (
        replace(f, found=replace(f.mapping, adjusted=replace(f.adjusted, influence=of))).sigma.rows_px
        for of in (influence, None)
    )
    return [j for j, (px, calm) in enumerate(zip(with_it, without, strict=True)) if px > limit_px >= calm]


OK_SIGMA_PX = 0.20
_OUTSIDE_LIMIT = 0.03
_CAUSES_OF_FAILURE = (ReasonCode.ROWS_LOST, ReasonCode.BOARD_OFF_PLANE)
_ENOUGH_FIDUCIALS = 3
"""Least number of found fiducials for which an error of one fiducial leaves residuals."""


_SEAM_CODES = "BOARD_OFF_PLANE OVERLAP_EXPOSURE OVERLAP_BLANK OVERLAP_REPETITIVE NOT_EXPLAINED"


class Check(NamedTuple):
    """A check of a stitched run. The verdict is made of the reasons that the checks find, and of nothing else."""

    find: Callable[[Any], Iterable[Reason]]
    """Yields a reason for each thing that is beyond the limit, from the findings or from those of a placed board."""
    names: str
    """Names of the codes of its reasons."""
    limit: str
    """What is still accepted."""
    of_board: bool = False
    """Whether it needs the position of the board."""
    reads_pixels: bool = False
    """Whether it costs milliseconds, because it reads frames; most read them only where something else is wrong."""

    @property
    def codes(self) -> frozenset[ReasonCode]:
        """The codes of its reasons."""
        return frozenset(ReasonCode[name] for name in self.names.split())


class _Placed(NamedTuple):
    """The inputs of the checks of a board that was found."""

    findings: Findings
    plane: BoardPlane
    mapping: CadMapping
    similarity: Floats

    @property
    def points(self) -> FiducialPoints | None:
        """The observed points with known CAD coordinates; None if there are none."""
        return self.mapping.problem.fiducials

    @property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras in the calibrated plane."""
        return float(np.mean([camera.px_per_mm for camera in self.findings.scene.cameras]))


def judge_result(f: Findings) -> tuple[Status, tuple[Reason, ...]]:
    """Decide the status of a result and return it with its reasons. For a failure, the cause comes first."""
    if not f.scene.present:
        nothing = "no usable frame of any camera arrived: there is nothing to stitch"
        return Status.FAILED, (Reason(ReasonCode.NO_FRAMES, nothing), *_doubtful_frames(f))
    reasons = tuple(_reasons(f))
    if isinstance(f.found, Failure):
        # A camera that delivered no frame explains the failure better than the fiducials that are missing because of
        # it.
        absent = absent_camera_reasons(f.scene, f.plane if f.method.marks else None, f.expectation, f.moved.motion)
        # Lost rows come first for the same reason: if they separate groups of rows, no fiducial is where it is
        # expected. A board far off the calibrated plane comes next: its fiducials seem too far apart or too close
        # together.
        causes = (*absent, *(reason for reason in reasons if reason.code in _CAUSES_OF_FAILURE))
        failure = Reason(ReasonCode(f.found.code), f.found.reason)
        sizes = () if causes else _other_sizes(f, ReasonCode(f.found.code))
        others = (reason for reason in reasons if reason not in causes)
        return Status.FAILED, (*causes, *sizes, failure, *others)
    return (Status.DEGRADED if reasons else Status.OK), reasons


def _other_sizes(f: Findings, failure: ReasonCode) -> tuple[Reason, ...]:
    """Return a reason if the fiducials have another size than the board type states, so that they were not found."""
    if failure is not ReasonCode.FIDUCIALS_NOT_FOUND or f.plane is None:
        return ()
    texture = board_texture(f.problem.links, f.moved)
    found = wrong_size(f.plane.board_type, f.scene, f.expectation, f.moved.motion, texture)
    return () if found is None else (found,)


def _reasons(f: Findings) -> Iterator[Reason]:
    placed = None
    if f.plane is not None and f.mapping is not None and f.adjusted.similarity is not None:
        placed = _Placed(f, f.plane, f.mapping, f.adjusted.similarity)
    for check in CHECKS:
        if not check.of_board:
            yield from check.find(f)
        elif placed is not None:
            yield from check.find(placed)


def _doubtful_frames(f: Findings) -> Iterable[Reason]:
    return (Reason(ReasonCode.TRIGGER_DOUBTFUL, doubt) for doubt in f.scene.doubts)


def _no_texture(f: Findings) -> Iterator[Reason]:
    if f.method.links and not any(len(e.a_px) for e in f.links):
        yield Reason(ReasonCode.NO_TEXTURE, "no texture was found in any frame: is there a board?")


def _dark_lights(f: Findings) -> Iterable[Reason]:
    return dark_light_reasons(f.dark)


def _cameras_in_wrong_rows(f: Findings) -> Iterator[Reason]:
    shifted = shifted_cameras(f.row_offsets, len(f.scene.cameras))
    check = "check its trigger line and the latency of its time stamps (latency_us in station.toml)"
    for camera, offset in shifted.items():
        where = "later" if offset < 0 else "earlier"
        yield Reason(
            ReasonCode.WRONG_ROWS,
            f"the frames of camera {camera} match those of its neighbours one row {where}: they are in wrong rows, "
            f"and their matrices are those of other places; {check}",
        )
    if not shifted:
        for (i, j), offset in f.row_offsets.items():
            yield Reason(
                ReasonCode.WRONG_ROWS,
                f"the frames of camera {j} match those of camera {i} one row {'later' if offset < 0 else 'earlier'}: "
                f"those of one of the two are in wrong rows; {check}",
            )


def _disagreeing_cameras(f: Findings) -> Iterator[Reason]:
    for (i, j), px in f.seams_px.items():
        if (i, j) not in f.row_offsets and px > SEAM_LIMIT_PX:
            symptom = f"cameras {i} and {j} disagree by {px:.2f} px (limit {SEAM_LIMIT_PX})"
            yield explain_seam(f.scene, f.links, (i, j), symptom, f.lift)


def _displaced_cameras(f: Findings) -> Iterator[Reason]:
    # To cameras in a line, a board off its plane looks the same as an array that is stretched.
    height = (
        ""
        if len(f.adjusted.surface_mm)
        else ". A board off the calibrated plane, or bent, looks alike: without working_distance_mm in the calibration "
        "its height is not estimated"
    )
    for camera, displacement_px, rivals in () if f.far_off_plane else f.displaced_cameras:
        x, y, turn = displacement_px
        pairs = [(i, i + 1) for i in (camera - 1, camera) if 0 <= i < len(f.scene.cameras) - 1]
        symptom = f"camera {camera} seems displaced by ({x:+.1f}, {y:+.1f}) px"
        repeated = (repeated_overlap(f.scene, f.links, pair, symptom) for pair in pairs)
        if pattern := next((reason for reason in repeated if reason is not None), None):
            yield pattern
            continue
        others = "".join(f" (or camera {i} the other way)" for i in rivals)
        yield Reason(
            ReasonCode.CAMERA_DISPLACED,
            f"camera {camera}{others} is displaced by ({x:+.2f}, {y:+.2f}) px, and by {turn:+.2f} px at its corners "
            f"by a turn, against its calibration (limit {DISPLACED_PX}). This run is corrected by it: "
            f"correct the calibration with `vaoi recalibrate`, or calibrate again{height}",
        )


def _non_overlapping_cameras(f: Findings) -> Iterator[Reason]:
    for (i, j), rows in f.non_overlapping_pairs.items():
        if (i, j) not in f.row_offsets:
            symptom = f"cameras {i} and {j} show different things where they should overlap (in {rows} rows)"
            yield explain_seam(f.scene, f.links, (i, j), symptom, f.lift)


def _missing_fiducials(b: _Placed) -> Iterator[Reason]:
    # A reference run or fixture marks also place the board. A missing fiducial is then no reason.
    if not b.findings.method.marks:
        return
    which = b.points.which if b.points is not None else np.zeros(0, dtype=np.int_)
    found = {int(w) for w in which if w >= 0}
    local = b.plane.board_type.apart_from_c(found, b.points.fixture_marks if b.points is not None else 0)
    seen = found - local
    if (which < 0).any() or len(seen) >= _ENOUGH_FIDUCIALS:
        return
    in_view = b.findings.fiducials_in_view
    for n, fiducial in enumerate(b.plane.board_type.fiducials):
        if n in seen or n in local:
            continue
        if len(seen) < 2:
            alone = f"fiducial {fiducial.name} was not found; one fiducial alone does not locate the board"
            yield Reason(ReasonCode.FIDUCIAL_MISSING, alone)
        elif n in in_view:
            yield Reason(
                ReasonCode.FIDUCIAL_MISSING,
                f"fiducial {fiducial.name} was not found where the two others put it, although camera {in_view[n][0]} "
                f"shows that place in row {in_view[n][1]}: two fiducials do not show an error of one of them. Check "
                f"whether {fiducial.name} is covered or dirty, and whether the board is of this type",
            )


def _unusable_local_fiducials(b: _Placed) -> Iterator[Reason]:
    if not b.findings.method.marks:
        return
    # A fiducial that no frame shows is missing in the frames, not on the board.
    in_view = {b.plane.board_type.fiducials[n].name for n in b.findings.fiducials_in_view}
    skipped = b.findings.skipped_parts
    places = [(ref, p) for ref, p in b.findings.own_places.local.items() if ref not in skipped]
    refused = [(ref, p) for ref, p in places if p.refusal and (p.fiducials or in_view.intersection(p.lost))]
    if refused:
        shown = "; ".join(f"{ref}: {place.refusal}" for ref, place in refused[:4])
        more = f" and {len(refused) - 4} more" if len(refused) > 4 else ""
        text = f"local fiducials do not place {len(refused)} components, which follow the board: {shown}{more}"
        yield Reason(ReasonCode.LOCAL_FIDUCIAL_UNUSABLE, text)


def _boards_of_panel(b: _Placed) -> Iterator[Reason]:
    f = b.findings
    bad = {position for position, marks in f.bad_marks.items() if marks.state == "bad"}
    # Without its fiducials nothing shows where a board of the panel lies, whatever locates the panel.
    places = {position: place for position, place in f.own_places.boards.items() if position not in bad}
    yield from board_reasons(places, b.px_per_mm, searched=f.method.marks)
    yield from mark_reasons(f.bad_marks)


def _disagreeing_fiducials(b: _Placed) -> Iterator[Reason]:
    adjusted = b.findings.adjusted
    yield from fiducial_reasons(b.plane, adjusted, b.points, b.findings.moved.motion, b.px_per_mm)
    yield from common_local_reasons(b.plane, adjusted, b.points, b.px_per_mm)
    yield from reference_reasons(b.points, adjusted.fiducial_px)


def _shifted_board(b: _Placed) -> Iterator[Reason]:
    yield from outline_reasons(b.mapping.shift, b.px_per_mm)
    f = b.findings
    yield from component_reasons(f.component_shift, b.plane, f.adjusted, b.points, b.px_per_mm)


def _unlike_reference(b: _Placed) -> Iterator[Reason]:
    f = b.findings
    if f.taught is None or shown_by_points(b.plane, b.points, f.adjusted.fiducial_px):
        return
    likeness = compare_components(b.plane, f.part_views, f.scene, f.taught)
    if likeness.other_type:
        yield Reason(
            ReasonCode.REFERENCE_CONTRADICTS,
            f"only {likeness.alike} of {likeness.compared} components look as in the reference: the board is of "
            f"another type than {b.plane.board_type.name!r}, or its pictures are too dark or blurred; compare the "
            "board with its order, or teach again if the boards were changed",
        )


def _unlisted_parts(b: _Placed) -> Iterable[Reason]:
    # Where components show their centres, or a reference their pictures, the list of parts may simply be incomplete.
    f = b.findings
    if f.component_shift is not None or f.taught is not None or not b.plane.board_type.components:
        return []
    return unlisted_part_reasons(find_unlisted_parts(b.plane, f.problem, f.adjusted), b.plane)


def _ambiguous_orientation(b: _Placed) -> Iterator[Reason]:
    if b.mapping.ambiguous:
        yield Reason(
            ReasonCode.ORIENTATION_AMBIGUOUS,
            "the fiducials also fit a board that is turned by 180°, and neither outline nor components decide: "
            "the expected orientation is used (one taught reference whose orientation a person has confirmed decides: "
            "`vaoi teach --confirm-orientation`; or a third fiducial that breaks the symmetry)",
        )


def _invisible_outline(b: _Placed) -> Iterator[Reason]:
    outline = b.mapping.outline
    if outline is not None and not outline.visible:
        yield Reason(
            ReasonCode.OUTLINE_INVISIBLE,
            f"there is no edge where the board's outline should be (contrast {outline.contrast:.1f} "
            f"grey levels over {outline.pieces} places): the board is of another type, or it lies elsewhere",
        )


def _texture_off_the_board(b: _Placed) -> Iterator[Reason]:
    left_out = b.mapping.left_out
    if left_out is not None:
        # The pictures show where the board ends, so texture outside the outline belongs to a carrier or to the belt. So
        # do three fiducials: if all of them fit, the outline lies where C puts it, although no edge stands out there.
        if not left_out.confirmed and not _placed_by_fiducials(b):
            yield Reason(
                ReasonCode.TEXTURE_OFF_BOARD,
                f"{left_out.share:.0%} of the texture lies off the board (limit {_OUTSIDE_LIMIT:.0%}), and the board's "
                "edges do not show where they should be: the board is of another type or turned, or it rides in a "
                "carrier or on a belt that is as bright as its edge; compare the outline of the board type with the "
                "board, and use a carrier that is brighter or darker",
            )
        return
    o, adjusted = b.findings.problem.links, b.findings.adjusted
    # Only links from row to row are used. Their points move with the board; links at a seam may lie on the conveyor.
    use = (adjusted.weight > 0.5) & (o.p != o.q)
    share = outside_share(b.plane, b.similarity, adjusted.motion.board(o.p[use], o.a_mm[use]))
    if share > _OUTSIDE_LIMIT:
        off = f"{share:.0%} of the texture lies off the board (limit {_OUTSIDE_LIMIT:.0%}): another type, or turned?"
        yield Reason(ReasonCode.TEXTURE_OFF_BOARD, off)


def _placed_by_fiducials(b: _Placed) -> bool:
    """Return whether all fiducials of the board type were found, and leave no choice of position and orientation."""
    every = len(b.plane.board_type.fiducials)
    found = set() if b.points is None else set(b.points.which[b.points.which >= 0].tolist())
    return every >= _ENOUGH_FIDUCIALS and len(found) == every and not b.mapping.ambiguous


def _uncertain_positions(b: _Placed) -> Iterator[Reason]:
    worst = b.findings.sigma.worst_px
    # in this form, because a value that is no number must not be ok
    if worst is not None and not worst <= OK_SIGMA_PX:
        blamed = uncertain_detections(b.plane, b.points, OK_SIGMA_PX) + uncertain_calibration(
            b.findings.calibrated, OK_SIGMA_PX / 2
        )
        blamed += disputed_positions(b.findings, OK_SIGMA_PX)
        uncertain = f"positions are uncertain by {worst:.3f} px (1 σ, limit {OK_SIGMA_PX}){blamed}"
        yield Reason(ReasonCode.POSITIONS_UNCERTAIN, uncertain)


def _unconfirmed_frames(b: _Placed) -> Iterable[Reason]:
    # In such a frame, the picture of a component may show anything, even if other frames show the component well.
    f = b.findings
    dark = {row for light in f.dark for row in light.rows}
    return unconfirmed_reasons([key for key in f.unconfirmed if key[1] not in dark], f.copies, f.checked.repeated)


def _distorted_pictures(b: _Placed) -> Iterable[Reason]:
    return lens_reasons(b.findings.lens_errors)


def _blurred_pictures(b: _Placed) -> Iterable[Reason]:
    return [] if b.points is None else blur_reasons(camera_blurs(b.plane, b.findings.scene, b.points))


def _unseen_components(b: _Placed) -> Iterable[Reason]:
    f, total = b.findings, len(b.plane.board_type.components)
    return unseen_reasons(f.unseen, total, f.scene, f.rows, f.unplaced)


CHECKS = (
    Check(_doubtful_frames, "TRIGGER_DOUBTFUL", "no doubt when the run was recorded"),
    Check(_no_texture, "NO_TEXTURE", "one link"),
    Check(_dark_lights, "LIGHT_DARK", "5 % of the contrast beside", reads_pixels=True),
    Check(unconnected_rows, "ROWS_NOT_CONNECTED ROWS_LOST", "three links between rows"),
    Check(repeated_rows, "ROWS_REPETITIVE", "a mark in every group of rows"),
    Check(scattered_links, "LINKS_SCATTER", f"{_FLOOR_LIMIT_PX} px"),
    Check(_cameras_in_wrong_rows, "WRONG_ROWS", "12 links, twice those without offset", reads_pixels=True),
    Check(_disagreeing_cameras, _SEAM_CODES, f"{SEAM_LIMIT_PX} px", reads_pixels=True),
    Check(_displaced_cameras, "CAMERA_DISPLACED OVERLAP_REPETITIVE", f"{DISPLACED_PX} px", reads_pixels=True),
    Check(_non_overlapping_cameras, _SEAM_CODES, "12 links", reads_pixels=True),
    Check(_missing_fiducials, "FIDUCIAL_MISSING", "three fiducials", of_board=True),
    Check(_unusable_local_fiducials, "LOCAL_FIDUCIAL_UNUSABLE", "0.3 mm", of_board=True),
    Check(_boards_of_panel, "BOARD_UNPLACED FIDUCIAL_OFF_PLACE BAD_BOARD_DOUBTFUL", "0.3 px", True, reads_pixels=True),
    Check(
        _disagreeing_fiducials,
        "FIDUCIAL_OFF_PLACE SCALE_WRONG SURFACE_UNLIKELY FIDUCIAL_WRONG REFERENCE_CONTRADICTS",
        "0.3 px, 0.05 %, 4 standard deviations",
        of_board=True,
    ),
    Check(_shifted_board, "OUTLINE_SHIFTED OUTLINE_TURNED COMPONENTS_SHIFTED", "0.5 mm", True, reads_pixels=True),
    Check(_unlike_reference, "REFERENCE_CONTRADICTS", "30 % of the components", of_board=True, reads_pixels=True),
    Check(_unlisted_parts, "UNLISTED_PARTS", "3 % of the bare board", of_board=True),
    Check(_ambiguous_orientation, "ORIENTATION_AMBIGUOUS", "evidence for one orientation", of_board=True),
    Check(_invisible_outline, "OUTLINE_INVISIBLE", "3 grey levels", of_board=True),
    Check(_texture_off_the_board, "TEXTURE_OFF_BOARD", f"{_OUTSIDE_LIMIT:.0%} of the links", of_board=True),
    Check(_distorted_pictures, "LENS_DIFFERS", "0.4 px at a corner", of_board=True),
    Check(_blurred_pictures, "PICTURES_BLURRED", "the blur of an edge", of_board=True, reads_pixels=True),
    Check(_uncertain_positions, "POSITIONS_UNCERTAIN", f"{OK_SIGMA_PX} px", of_board=True),
    Check(_unconfirmed_frames, "FRAMES_UNCONFIRMED", "half of the links of a frame", of_board=True, reads_pixels=True),
    Check(_unseen_components, "COMPONENTS_UNSEEN", "`visibility`", of_board=True),
)
"""All checks, in the order in which a result lists their reasons: those of the run, then those of a board in its place.
"""
