"""The verdict on a stitch, ok, degraded or failed, decided by a list of checks of its findings.

A result is ok if every position has a standard deviation of at most 0.2 px (`sigma_limit_px`), each component is seen
as much as is asked for, and no check fails. It is degraded if it is usable but a check fails, and failed if it contains
no positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from vaoi_station.geometry.camera_error import uncalibrated
from vaoi_station.geometry.robust import Failure
from vaoi_station.model import Reason, ReasonCode, Status
from vaoi_station.stitching.adjustment.problem import USED, Influence, Ints
from vaoi_station.stitching.adjustment.row_motion import board_texture
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
from vaoi_station.stitching.quality.findings import DISPLACED_PX, SEAM_LIMIT_PX, Findings, PlacedBoard
from vaoi_station.stitching.quality.pictures import blur_reasons, camera_blurs, lens_reasons
from vaoi_station.stitching.quality.seams import explain_seam, repeated_overlap, shifted_cameras
from vaoi_station.stitching.quality.uncertainty import seam_sigma_px
from vaoi_station.stitching.quality.visibility import unconfirmed_reasons, unseen_reasons

OK_SIGMA_PX = 0.20
_COARSE_SIGMA_MM, _COARSE_SIGMA_PX = 0.06, 0.25
"""On a coarse station, of 3.3 to 5 px/mm, what matters to a tester is the first value. The limit in px is never above
the second one, and falls from there to `OK_SIGMA_PX` as it rose, so that no resolution has a limit of its own."""
_OUTSIDE_LIMIT = 0.03
_ENOUGH_FIDUCIALS = 3
"""Least number of found fiducials for which an error of one fiducial leaves residuals."""
_FLOOR_LIMIT_PX, _UNEXPLAINED_PX, _UNEXPLAINED = 0.30, 0.15, 3.0
"""Largest scatter of links beyond image noise: in any case, and if it exceeds the image noise by the last factor, as
that of links on a belt as bright as the board does (seed 108935). Measured: of 3191 drawings that were `ok`, no other
one had more than 0.15 px and three times the noise."""


def judge_result(f: Findings) -> tuple[Status, tuple[Reason, ...]]:
    """Decide the status of a result and return it with its reasons. For a failure, the cause comes first."""
    if not f.scene.present:
        nothing = "no usable frame of any camera arrived: there is nothing to stitch"
        return Status.FAILED, (Reason(ReasonCode.NO_FRAMES, nothing), *_doubtful_frames(f))
    reasons = [*_reasons_of_run(f), *(_reasons_of_board(f, f.board) if f.board is not None else ())]
    if not isinstance(f.found, Failure):
        return (Status.DEGRADED if reasons else Status.OK), tuple(reasons)
    # An absent camera explains the failure better than the fiducials that are missing because of it. So do lost rows,
    # between which no fiducial is where it is expected, and a board far off the calibrated plane.
    delivered, nothing = {camera for camera, _ in f.scene.present}, "delivered no complete frame of this board"
    absent = (camera for camera in range(len(f.scene.cameras)) if camera not in delivered)
    causes = [Reason(ReasonCode.CAMERA_ABSENT, f"camera {camera} {nothing}") for camera in absent]
    causes += [r for r in reasons if r.code in (ReasonCode.ROWS_LOST, ReasonCode.BOARD_OFF_PLANE)]
    sizes = None
    if not causes and f.found.code == ReasonCode.FIDUCIALS_NOT_FOUND and f.plane is not None:
        texture = board_texture(f.problem.links, f.moved)
        sizes = wrong_size(f.plane.board_type, f.scene, f.expectation, f.moved.motion, texture)
    failure = Reason(ReasonCode(f.found.code), f.found.reason)
    others = (reason for reason in reasons if reason not in causes)
    return Status.FAILED, (*causes, *([sizes] if sizes else []), failure, *others)


def _doubtful_frames(f: Findings) -> Iterable[Reason]:
    return (Reason(ReasonCode.TRIGGER_DOUBTFUL, doubt) for doubt in f.scene.doubts)


def _reasons_of_run(f: Findings) -> Iterator[Reason]:
    """Yield the reasons of all checks that need no place of the board, in the order in which a result lists them."""
    yield from _doubtful_frames(f)
    if f.method.links and not any(len(e.a_px) for e in f.links):
        yield Reason(ReasonCode.NO_TEXTURE, "no texture was found in any frame: is there a board?")
    yield from dark_light_reasons(f.dark)
    yield from _unconnected_rows(f)
    yield from _repeated_rows(f)
    yield from scattered_links(f)
    yield from _cameras_in_wrong_rows(f)
    yield from _disagreeing_cameras(f)
    yield from _displaced_cameras(f)
    yield from _uncalibrated_cameras(f)
    yield from _non_overlapping_cameras(f)


def _reasons_of_board(f: Findings, b: PlacedBoard) -> Iterator[Reason]:
    """Yield the reasons of the checks of a board in its place."""
    yield from _missing_fiducials(f, b)
    yield from unusable_local_fiducials(f, b)
    # Without its fiducials nothing shows where a board of the panel lies, whatever locates the panel.
    boards = {position: place for position, place in f.own_places.boards.items() if position not in f.bad_boards}
    yield from board_reasons(boards, f.px_per_mm, searched=f.method.marks)
    yield from mark_reasons({at: marks for at, marks in f.bad_marks.items() if at not in f.bad_boards})
    yield from fiducial_reasons(b.plane, f.adjusted, f.points, f.moved.motion, f.px_per_mm)
    yield from common_local_reasons(b.plane, f.adjusted, f.points, f.px_per_mm)
    yield from reference_reasons(f.points, f.adjusted.fiducial_px)
    yield from outline_reasons(b.mapping.shift, f.px_per_mm)
    yield from component_reasons(f.component_shift, b.plane, b.matrix, f.points, f.px_per_mm)
    yield from _unlike_reference(f, b)
    # Where components show their centres, or a reference their pictures, the list of parts may simply be incomplete.
    if f.component_shift is None and f.taught is None and b.plane.board_type.components:
        yield from unlisted_part_reasons(find_unlisted_parts(b.plane, f.problem, f.adjusted), b.plane)
    yield from _doubtful_place(b)
    yield from _texture_off_the_board(f, b)
    yield from lens_reasons(f.lens_errors)
    yield from blur_reasons(camera_blurs(b.plane, f.scene, f.points))
    yield from _uncertain_positions(f, b)
    # In such a frame, the picture of a component may show anything, even if other frames show the component well.
    dark = {row for light in f.dark for row in light.rows}
    unconfirmed = [key for key in f.unconfirmed if key[1] not in dark]
    yield from unconfirmed_reasons(unconfirmed, f.copies, f.checked.repeated)
    yield from unseen_reasons(f.unseen, len(b.plane.board_type.components), f.scene, f.rows, f.unplaced)


def _unconnected_rows(f: Findings) -> Iterator[Reason]:
    if f.unplaced:
        # Rows at the board's ends that hardly show it do not count.
        if not f.unseen and not any(set(f.unplaced) & set(g.tolist()) for g in f.connected_groups):
            return
        text = (
            f"no links connect the rows {_named(f.unplaced)} with the rows in which the board is placed: how far the "
            "belt moved in between is not known, and these rows have no matrices and no views"
        )
        lost = [row for row, placed in enumerate(f.placed) if not placed and row not in f.unplaced]
        end = ". Check the belt, and film the board again"
        lost_end = ": repair what lost these frames and film the board again"
    else:
        groups = _groups_of_rows(f)
        if len(groups) < 2:
            return
        parts = ", ".join(f"{g.min()}–{g.max()}" for g in groups)
        text = f"no links connect the rows {parts} with one another: the belt's nominal speed gives their distance"
        gaps = [range(int(a.max()) + 1, int(b.min())) for a, b in pairwise(groups)]
        lost, end = [row for gap in gaps for row in gap if not f.placed[row]], ""
        lost_end = (
            ". Fiducials on both sides of the gap may not fit together for that reason: repair what lost these frames "
            "and film the board again"
        )
    if not lost:
        yield Reason(ReasonCode.ROWS_NOT_CONNECTED, text + end)
        return
    rows = f"row{'s' if len(lost) > 1 else ''} {', '.join(map(str, lost))}"
    yield Reason(ReasonCode.ROWS_LOST, f"no camera delivered a good frame of {rows}, and {text}{lost_end}")


def _groups_of_rows(f: Findings) -> list[Ints]:
    if len(f.connected_groups) > 1:
        return f.connected_groups
    # A single row without links to other rows is in no group.
    o, marked = f.problem.links, f.points.row
    seen, placed = np.append(o.p, o.q), np.flatnonzero(f.placed)
    for last, first in ((a, b) for a, b in pairwise(placed.tolist()) if b > a + 1):
        sides = [((rows <= last).any(), (rows >= first).any()) for rows in (seen, marked)]
        spanned = ((o.p <= last) & (o.q >= first) | (o.q <= last) & (o.p >= first)).any()
        if not spanned and all(sides[0]) and not all(sides[1]):
            return [placed[placed <= last], placed[placed >= first]]
    return f.connected_groups


def _named(rows: Sequence[int]) -> str:
    """Return the words for rows, such as "1–3, 5"."""
    groups = np.split(np.array(rows), np.flatnonzero(np.diff(rows) > 1) + 1)
    return ", ".join(f"{g[0]}" if len(g) == 1 else f"{g[0]}–{g[-1]}" for g in groups)


def rows_apart(f: Findings) -> list[list[int]]:
    """Return the groups of rows whose distance from the other rows is uncertain by periods of a repeated pattern.

    A group that shows a fiducial is certain: a motion that is wrong by a period would displace that fiducial. If no
    row shows one, all groups are returned.
    """
    cuts = {(e.task.a[1], e.task.b[1]) for e in f.links if e.ambiguous and e.task.b is not None}
    rows, marked = sorted({row for _, row in f.scene.present}), set(f.points.row.tolist())
    ends = [n + 1 for n, pair in enumerate(pairwise(rows)) if pair in cuts]
    groups = [rows[a:b] for a, b in pairwise([0, *ends, len(rows)])] if ends else []
    return [group for group in groups if not marked & set(group)]


def _repeated_rows(f: Findings) -> Iterator[Reason]:
    unsure = [row for group in rows_apart(f) for row in group]
    if unsure:
        yield Reason(
            ReasonCode.ROWS_REPETITIVE,
            f"a repeated pattern connects the rows {_named(unsure)} with the others at several motions of the belt, "
            "and no fiducial in these rows decides between them: the motion nearest to the nominal speed is used; use "
            "a reference, or fiducials that every row shows",
        )


def scattered_links(f: Findings) -> Iterator[Reason]:
    """Yield a reason if the links between rows scatter by more than noise explains."""
    links, floor = f.problem.links, f.adjusted.floor_px
    if floor <= _UNEXPLAINED_PX:
        return
    noise = links.median_noise_px(np.flatnonzero((f.adjusted.weight > USED) & (links.p != links.q)))
    if floor > _FLOOR_LIMIT_PX:
        scatter = f"links scatter by {floor:.2f} px (limit {_FLOOR_LIMIT_PX})"
        yield Reason(ReasonCode.LINKS_SCATTER, f"{scatter}: the board is not rigid or flat")
    elif floor > _UNEXPLAINED * noise:
        yield Reason(
            ReasonCode.LINKS_SCATTER,
            f"links scatter by {floor:.2f} px, of which image noise explains {noise:.2f} px (limit {_UNEXPLAINED_PX}): "
            "what the frames show does not move as one board; use a belt or carrier that is darker or brighter than "
            "the board's edge, and check that the board is rigid",
        )


def _cameras_in_wrong_rows(f: Findings) -> Iterator[Reason]:
    check = "check its trigger line and the latency of its time stamps (latency_us in station.toml)"
    where = {True: "one row later", False: "one row earlier"}
    shifted = shifted_cameras(f.row_offsets, len(f.scene.cameras))
    for camera, offset in shifted.items():
        yield Reason(
            ReasonCode.WRONG_ROWS,
            f"the frames of camera {camera} match those of its neighbours {where[offset < 0]}: they are in wrong rows, "
            f"and their matrices are those of other places; {check}",
        )
    for (i, j), offset in () if shifted else f.row_offsets.items():
        yield Reason(
            ReasonCode.WRONG_ROWS,
            f"the frames of camera {j} match those of camera {i} {where[offset < 0]}: those of one of the two are in "
            f"wrong rows; {check}",
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
    new = uncalibrated(f.calibrated)
    for camera, (x, y, turn), rivals in () if f.far_off_plane else f.displaced_cameras:
        if camera in new:
            continue
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


def _uncalibrated_cameras(f: Findings) -> Iterator[Reason]:
    estimate = f.adjusted.cameras
    for camera in uncalibrated(f.calibrated):
        x, y, turn = (0.0, 0.0, 0.0) if estimate is None else estimate.displacement_px[camera]
        yield Reason(
            ReasonCode.CAMERA_NOT_CALIBRATED,
            f"camera {camera} was exchanged and is not calibrated yet. By this run alone its picture lies ({x:+.2f}, "
            f"{y:+.2f}) px, and by {turn:+.2f} px at its corners by a turn, beside that of its predecessor: confirm "
            "its calibration on the page Cameras, or use `vaoi recalibrate`",
        )


def _non_overlapping_cameras(f: Findings) -> Iterator[Reason]:
    for (i, j), rows in f.non_overlapping_pairs.items():
        if (i, j) not in f.row_offsets:
            symptom = f"cameras {i} and {j} show different things where they should overlap (in {rows} rows)"
            yield explain_seam(f.scene, f.links, (i, j), symptom, f.lift)


def _missing_fiducials(f: Findings, b: PlacedBoard) -> Iterator[Reason]:
    which, board = f.points.which, b.plane.board_type
    placing, local = b.plane.placing(f.points), board.apart_from_c(which.tolist())
    # A reference run or fixture marks also place the board. A missing fiducial is then no reason.
    if not f.method.marks or (which < 0).any() or len(placing) >= _ENOUGH_FIDUCIALS:
        return
    for n, fiducial in enumerate(board.fiducials):
        if n in which or n in local:
            continue
        if len(placing) < 2:
            alone = f"fiducial {fiducial.name} was not found; one fiducial alone does not locate the board"
            yield Reason(ReasonCode.FIDUCIAL_MISSING, alone)
        elif n in f.fiducials_in_view:
            camera, row = f.fiducials_in_view[n]
            yield Reason(
                ReasonCode.FIDUCIAL_MISSING,
                f"fiducial {fiducial.name} was not found where the two others put it, although camera {camera} "
                f"shows that place in row {row}: two fiducials do not show an error of one of them. Check "
                f"whether {fiducial.name} is covered or dirty, and whether the board is of this type",
            )


def unusable_local_fiducials(f: Findings, b: PlacedBoard) -> Iterator[Reason]:
    """Yield a reason if local fiducials, which frames show, do not place their components."""
    # A fiducial that no frame shows is missing in the frames, not on the board.
    in_view = {b.plane.board_type.fiducials[n].name for n in f.fiducials_in_view} if f.method.marks else set()
    refused = [
        f"{ref}: {p.refusal}"
        for ref, p in f.own_places.local.items()
        if f.method.marks and p.refusal and ref not in f.skipped_parts and (p.fiducials or in_view.intersection(p.lost))
    ]
    if refused:
        more = f" and {len(refused) - 4} more" if len(refused) > 4 else ""
        text = f"local fiducials do not place {len(refused)} components, which follow the board: "
        yield Reason(ReasonCode.LOCAL_FIDUCIAL_UNUSABLE, f"{text}{'; '.join(refused[:4])}{more}")


def _unlike_reference(f: Findings, b: PlacedBoard) -> Iterator[Reason]:
    if f.taught is None or shown_by_points(b.plane, f.points, f.adjusted.fiducial_px):
        return
    likeness = compare_components(b.plane, f.part_views, f.scene, f.taught)
    if likeness.other_type:
        yield Reason(
            ReasonCode.REFERENCE_CONTRADICTS,
            f"only {likeness.alike} of {likeness.compared} components look as in the reference: the board is of "
            f"another type than {b.plane.board_type.name!r}, or its pictures are too dark or blurred; compare the "
            "board with its order, or teach again if the boards were changed",
        )


def _doubtful_place(b: PlacedBoard) -> Iterator[Reason]:
    outline = b.mapping.outline
    if b.mapping.ambiguous:
        yield Reason(
            ReasonCode.ORIENTATION_AMBIGUOUS,
            "the fiducials also fit a board that is turned by 180°, and neither outline nor components decide: "
            "the expected orientation is used (one taught reference whose orientation a person has confirmed decides: "
            "`vaoi teach --confirm-orientation`; or a third fiducial that breaks the symmetry)",
        )
    if outline is not None and not outline.visible:
        yield Reason(
            ReasonCode.OUTLINE_INVISIBLE,
            f"there is no edge where the board's outline should be (contrast {outline.contrast:.1f} "
            f"grey levels over {outline.pieces} places): the board is of another type, or it lies elsewhere",
        )


def _texture_off_the_board(f: Findings, b: PlacedBoard) -> Iterator[Reason]:
    left_out, o, adjusted = b.mapping.left_out, f.problem.links, f.adjusted
    if left_out is None:
        # Only links from row to row are used. Their points move with the board; those at a seam may lie on the belt.
        use = np.flatnonzero((adjusted.weight > 0.5) & (o.p != o.q))
        share = outside_share(b.plane, b.c, adjusted.motion.board(o.p.take(use), o.a_mm.take(use, axis=0)))
        if share > _OUTSIDE_LIMIT:
            off = f"{share:.0%} of the texture lies off the board (limit {_OUTSIDE_LIMIT:.0%})"
            yield Reason(ReasonCode.TEXTURE_OFF_BOARD, f"{off}: another type, or turned?")
        return
    # If all of three fiducials fit, the outline lies where C puts it, although no edge stands out there.
    every, found = len(b.plane.board_type.fiducials), set(f.points.which[f.points.which >= 0].tolist())
    surely = every >= _ENOUGH_FIDUCIALS and len(found) == every and not b.mapping.ambiguous
    if not left_out.confirmed and not surely:
        yield Reason(
            ReasonCode.TEXTURE_OFF_BOARD,
            f"{left_out.share:.0%} of the texture lies off the board (limit {_OUTSIDE_LIMIT:.0%}), and the board's "
            "edges do not show where they should be: the board is of another type or turned, or it rides in a "
            "carrier or on a belt that is as bright as its edge; compare the outline of the board type with the "
            "board, and use a carrier that is brighter or darker",
        )


def _uncertain_positions(f: Findings, b: PlacedBoard) -> Iterator[Reason]:
    worst, px_per_mm = f.sigma.worst_px, float(np.mean([camera.px_per_mm for camera in f.calibrated]))
    limit_px = sigma_limit_px(px_per_mm)
    # in this form, because a value that is no number must not be ok
    if worst is None or worst <= limit_px:
        return
    blamed = uncertain_detections(b.plane, f.points, limit_px)
    seams = [seam_sigma_px(camera) for camera in f.calibrated]
    if unsure := [str(i) for i, px in enumerate(seams) if px > limit_px / 2]:
        who = f"camera{'s' if len(unsure) > 1 else ''} {', '.join(unsure)}"
        blamed += f"; the calibration of {who} leaves ± {max(seams):.2f} px at the seams"
        blamed += ": calibrate with more marks per camera"
    blamed += disputed_positions(f, limit_px)
    um = f"{worst / px_per_mm * 1e3:.0f} µm on the board, limit {limit_px / px_per_mm * 1e3:.0f} µm"
    uncertain = f"positions are uncertain by {worst:.3f} px (1 σ, limit {limit_px:.2g}; {um}){blamed}"
    yield Reason(ReasonCode.POSITIONS_UNCERTAIN, uncertain)


def sigma_limit_px(px_per_mm: float) -> float:
    """Return the largest standard deviation of a position that is `ok`, px, at the calibrated cameras' resolution."""
    largest_at_px_per_mm = _COARSE_SIGMA_PX / _COARSE_SIGMA_MM
    return max(OK_SIGMA_PX, _COARSE_SIGMA_PX - _COARSE_SIGMA_MM * abs(px_per_mm - largest_at_px_per_mm))


def disputed_positions(f: Findings, limit_px: float) -> str:
    """Return clauses that name what decides positions by more than noise explains; empty if nothing does."""
    influence, mapping = f.adjusted.influence, f.mapping
    if influence is None or mapping is None:
        return ""

    def rows_px(of: Influence | None) -> Sequence[float]:
        return replace(f, found=replace(mapping, adjusted=replace(f.adjusted, influence=of))).sigma.rows_px

    calm = rows_px(None)

    def uncertain_by(of: Influence) -> list[int]:
        return [j for j, px in enumerate(rows_px(of)) if px > limit_px >= calm[j]]

    if not (rows := uncertain_by(influence)):
        return ""
    marks, places = (uncertain_by(influence.select(at)) for at in (influence.of_marks, ~influence.of_marks))
    clauses = ""
    if marks or not places:
        clauses += (
            "; without one of the marks that place the board (fiducials, fixture, reference) positions move by more "
            "than noise explains: these marks contradict one another. Check whether a mark is dirty or covered, and "
            "compare the marks in the board type with the board"
        )
    if places or not marks:
        clauses += (
            f"; positions in row{'s' if len(places or rows) > 1 else ''} {_named(places or rows)} follow from few "
            "places of the pictures, and without one of these they move by more than noise explains: it may show the "
            "belt, a shadow, or a part that the board type lacks. Let consecutive frames overlap more (a slower belt "
            "or a shorter period), and keep belt and carrier darker or brighter than the board's edge"
        )
    return clauses
