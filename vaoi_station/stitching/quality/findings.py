"""The findings of a run: all intermediate values of its stitching, from which verdict and result are derived."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vaoi_station.frame_index import FootprintViews, FrameIndex
from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import rms_displacement_px
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import VISIBILITY, Surface, Visibility
from vaoi_station.stitching.adjustment.problem import USED, AdjustmentResult, FiducialPoints, Problem, to_surface
from vaoi_station.stitching.adjustment.row_motion import MovedRows, connected_rows
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping
from vaoi_station.stitching.board.reference import ReferenceScene
from vaoi_station.stitching.components.bad_boards import BoardMarks, read_bad_marks
from vaoi_station.stitching.components.centres import ComponentShift, PartView, central_views, measure_component_shift
from vaoi_station.stitching.components.places import (
    OwnPlaces,
    components_of,
    own_places,
    placed_landmarks,
    placed_parts,
)
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.geometry import frames_of_marks
from vaoi_station.stitching.matching.evidence import FrameKey, Links, Method
from vaoi_station.stitching.matching.frames import Scene
from vaoi_station.stitching.quality.confirmation import (
    CheckedFrames,
    DarkLight,
    check_frames,
    frames_with_edge,
    linked_to_before,
    repeated_frames,
)
from vaoi_station.stitching.quality.heights import Height, component_heights
from vaoi_station.stitching.quality.pictures import LensError, lens_errors, position_errors_px
from vaoi_station.stitching.quality.seams import LIFT_LIMIT_MM, Lift, agreeing_links, measure_lift, row_offset, seam_px
from vaoi_station.stitching.quality.uncertainty import (
    PredictedSigma,
    predict_sigma,
    reference_share,
    seam_sigma_px,
)
from vaoi_station.stitching.quality.visibility import FilmedBoard, UnseenComponent, find_unseen, required_visibility

SEAM_LIMIT_PX = 0.30
"""Largest accepted disagreement of two cameras at their seam, px."""
DISPLACED_PX = 0.20
"""Displacements of a camera up to this are corrected without a reason in the result: px, rms over the frame."""
_SIGNIFICANT = 4.0
"""Number of standard deviations from which on the displacements of all cameras together are more than noise."""
_PLACED_SIGMA_PX = 2.0
"""Largest accepted standard deviation of a position in a row that neither links nor CAD points tie to other rows."""
_OTHER_LIFT_MM = 1.0
"""The lift measured by overlaps contradicts the lift of the adjustment if they differ by more than this."""
_SEAM_LINKS = 12
"""Least number of links between two cameras from which it can be decided whether the cameras agree."""


class PlacedBoard(NamedTuple):
    """A board that was found."""

    plane: BoardPlane
    mapping: CadMapping
    c: Floats
    """(4,) C as (a, b, x, y)."""
    matrix: Floats


@dataclass(frozen=True, eq=False)
class Findings:
    """The inputs, solutions and derived values of the stitching of one run; the latter are computed at first use."""

    plane: BoardPlane | None
    expectation: Expectation
    scene: Scene
    method: Method
    links: tuple[Links, ...]
    moved: MovedRows
    """The motion of the rows by the links alone, without CAD data."""
    calibrated: tuple[Camera, ...]
    """The cameras as calibrated. The cameras in `scene` include the displacements that the adjustment estimated."""
    found: CadMapping | Failure
    visibility: Visibility = VISIBILITY
    reference_sigma_px: float = 0.0
    """Standard deviation of positions on account of the reference's own CAD mapping, px; 0 without a reference."""
    taught: ReferenceScene | None = None
    """Result and frames of the reference; None if the run does not use one, or if its frames cannot be read."""
    unplaced: tuple[int, ...] = ()
    """Rows with good frames, not part of `scene`, that have no known position: nothing shows where the board was."""
    copies: frozenset[FrameKey] = frozenset()
    """Good frames that equal the frame before in every pixel, and so do not show the board of their row."""
    dark: tuple[DarkLight, ...] = ()

    @property
    def mapping(self) -> CadMapping | None:
        """The CAD mapping of the board; None if the board was not found."""
        return self.found if isinstance(self.found, CadMapping) else None

    @property
    def adjusted(self) -> AdjustmentResult:
        """The final solution: that of the CAD mapping if the board was found, otherwise that of the links alone."""
        return self.found.adjusted if isinstance(self.found, CadMapping) else self.moved.result

    @property
    def problem(self) -> Problem:
        """The adjustment problem whose solution is `adjusted`, with the displacements of the cameras applied."""
        return self.adjusted.problem

    @property
    def points(self) -> FiducialPoints:
        """The observed points with known CAD coordinates."""
        return self.problem.fiducials or FiducialPoints.empty()

    @property
    def rows(self) -> int:
        """Number of rows (m in the paper)."""
        return len(self.adjusted.motion.angle)

    @cached_property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras in the calibrated plane."""
        return float(np.mean([camera.px_per_mm for camera in self.scene.cameras]))

    @cached_property
    def board(self) -> PlacedBoard | None:
        """The board in its place; None if it was not found."""
        mapping, c = self.mapping, self.adjusted.similarity
        if self.plane is None or mapping is None or c is None:
            return None
        return PlacedBoard(self.plane, mapping, c, self.plane.matrix(c))

    @property
    def cad_matrix(self) -> Floats | None:
        """C as a 3×3 matrix; None without a CAD mapping."""
        return self.board and self.board.matrix

    @cached_property
    def sigma(self) -> PredictedSigma:
        """Predicted standard deviations of component positions, and of the rows."""
        predicted = predict_sigma(self.scene, self.plane, self.adjusted, self.views)
        share = reference_share(self.points, self.adjusted.fiducial_px) * self.reference_sigma_px
        camera, names, own = predicted.seen_in[:, 0], predicted.names, self.own_places.sigma_mm
        lens = position_errors_px(self.lens_errors, len(self.calibrated))
        error_px = np.hypot(share, np.array([lens.get(i, 0.0) for i in range(len(self.calibrated))])[camera])
        if own:
            # Of fiducials that place a component, or the board of a panel on which it is.
            px_per_mm = np.array([c.px_per_mm for c in self.scene.cameras])[camera]
            error_px = np.hypot(error_px, np.array([own.get(name, 0.0) for name in names])[predicted.part] * px_per_mm)
        demanded = np.ones(len(names), np.bool_)
        if self.skipped_parts:
            demanded[[name in self.skipped_parts for name in names]] = False
        return predicted.with_errors(error_px, demanded[predicted.part])

    @cached_property
    def lens_errors(self) -> dict[int, LensError]:
        """For each camera, the radial distortion that its calibration does not contain; empty without C."""
        if self.mapping is None or not self.method.links:
            return {}
        return lens_errors(self.problem, self.adjusted, self.scene.cameras)

    @cached_property
    def surface(self) -> Surface | None:
        """The surface of the board; None if it was not estimated."""
        if self.plane is None or self.mapping is None or not len(self.adjusted.surface_mm):
            return None
        return to_surface(self.plane.board_type, self.adjusted.surface_mm)

    @cached_property
    def own_places(self) -> OwnPlaces:
        """Places of boards of a panel and of components that do not follow C; empty without C."""
        if (b := self.board) is None:
            return OwnPlaces()
        return own_places(b.plane, self.adjusted, self.points, b.matrix)

    @cached_property
    def _frames(self) -> FrameIndex:
        index = self.scene.index(self.adjusted.motion.rows_from_tester, self.surface)
        return index if self.cad_matrix is None else replace(index, tester_from_cad=self.cad_matrix)

    @cached_property
    def views(self) -> FootprintViews | None:
        """Views of the components, or of two corners of the board if it has none, in frames that may show them."""
        return self._every_view and self._every_view.without_frames(self._misplaced)

    @cached_property
    def _every_view(self) -> FootprintViews | None:
        if (b := self.board) is None:
            return None
        cad = placed_landmarks(b.plane, b.matrix, self.own_places.matrices)
        return self._frames.views(cad).without_rows(self.unplaced)

    @cached_property
    def bad_marks(self) -> dict[str, BoardMarks]:
        """What the bad-board marks of a panel show, by position of the board; empty without C or such marks."""
        if (b := self.board) is None:
            return {}
        frames = replace(self._frames, present=tuple(self.checked.confirmed))
        return read_bad_marks(b.plane.board_type, self.own_places.of_boards, frames)

    @cached_property
    def bad_boards(self) -> tuple[str, ...]:
        """Positions of the boards of a panel that are crossed out, or not to be tested by their order."""
        crossed_out = (position for position, marks in self.bad_marks.items() if marks.state == "bad")
        return tuple(dict.fromkeys((*crossed_out, *self.expectation.skipped))) if self.board is not None else ()

    @cached_property
    def skipped_parts(self) -> frozenset[str]:
        """Addresses of the components of bad boards, which are not demanded."""
        return frozenset() if self.plane is None else components_of(self.plane, self.bad_boards)

    @cached_property
    def part_views(self) -> list[PartView]:
        """One view of each of some demanded components; empty without C."""
        if (b := self.board) is None or self.views is None:
            return []
        views = self.views.without_points([b.plane.components.addresses.index(ref) for ref in self.skipped_parts])
        return central_views(b.plane, b.matrix, self.scene, self.adjusted.motion, views)

    @cached_property
    def component_shift(self) -> ComponentShift | None:
        """Shift of the components' pictures against their places by C; None without C, or if too few show it."""
        if (b := self.board) is None:
            return None
        return measure_component_shift(b.plane, b.matrix, self.scene, self.adjusted.motion, self.part_views)

    @cached_property
    def fiducials_in_view(self) -> dict[int, FrameKey]:
        """One confirmed frame for each fiducial that a frame shows with its bare rim, by number; empty without C."""
        if (b := self.board) is None:
            return {}
        views = self._frames.views(b.plane.cad(b.plane.fiducials))
        return frames_of_marks(b.plane.board_type, views, self.scene.cameras, self.checked.confirmed)

    @cached_property
    def checked(self) -> CheckedFrames:
        """Which good frames fit the board's motion, and which contradict it."""
        beside = self.mapping.left_out.links if self.mapping and self.mapping.left_out else None
        checked = check_frames(frozenset(self.scene.present), self.copies, self.method, self.adjusted, beside)
        if (b := self.board) is None:
            return checked
        motion, undecided = self.adjusted.motion, self._seen - checked.confirmed - checked.refuted
        if undecided:
            edges = frames_with_edge(undecided, b.plane, b.matrix, self.scene, motion, self.problem.velocity_mm_s)
            checked = checked._replace(confirmed=checked.confirmed | edges)
        # Where a board gets stuck and a camera repeats a frame, other rows confirm both frames (seed 107464).
        linked = linked_to_before(self.problem.links, self.adjusted.weight)
        doubtful = self._seen - (checked.sure & linked) - checked.refuted
        repeated = repeated_frames(doubtful, b.plane, b.c, self.scene, motion)
        confirmed, refuted = checked.confirmed - repeated, checked.refuted | repeated
        return CheckedFrames(confirmed, refuted, checked.sure, repeated)

    @cached_property
    def _seen(self) -> frozenset[FrameKey]:
        """The good frames that should show a component; empty without C."""
        return (self._every_view.seen_in if self._every_view else frozenset()).intersection(self.scene.present)

    @cached_property
    def unconfirmed(self) -> tuple[FrameKey, ...]:
        """The good frames, in order, that contradict their row, or show a component without fitting the board."""
        # A copy of a frame beside the board is no loss, and without noise equals it by right.
        return tuple(sorted((self._seen - self.checked.confirmed) | (self.checked.refuted - self.copies)))

    @cached_property
    def unseen(self) -> tuple[UnseenComponent, ...]:
        """The components of which the good frames show less than is asked for; empty without C."""
        if (b := self.board) is None:
            return ()
        parts = placed_parts(b.plane, b.matrix, self.own_places.matrices)
        filmed = FilmedBoard(parts, self._frames)
        required = required_visibility(b.plane.board_type, self.visibility)
        views = self._every_view if parts.addresses else None
        unseen = find_unseen(filmed, self.checked.confirmed, self.problem.velocity_mm_s, required, views)
        return tuple(part for part in unseen if part.address not in self.skipped_parts)

    @cached_property
    def heights(self) -> dict[str, Height]:
        """Heights of components above the board, by address (`U1`, `panel/U1`); none where links are too few."""
        if self.plane is None or self.mapping is None:
            return {}
        return component_heights(self.plane, self.problem, self.adjusted)

    @cached_property
    def placed(self) -> tuple[bool, ...]:
        """For each row, whether it has at least one good frame. A row without good frames has no image matrices."""
        rows = {row for _, row in self.scene.present}
        return tuple(j in rows for j in range(self.rows))

    def places(self, camera: int, row: int) -> bool:
        """Return whether a frame has a matrix: its row is placed, and its picture does not contradict it."""
        return self.placed[row] and (camera, row) not in self._misplaced

    @cached_property
    def _misplaced(self) -> frozenset[FrameKey]:
        return self.checked.refuted & frozenset(self.unconfirmed)

    @cached_property
    def connected_groups(self) -> list[np.ndarray]:
        """Groups of rows that are connected by links or CAD points. Rows without texture belong to no group."""
        marked = set(self.points.row.tolist())
        # A row that shows only the belt, before or after the board, has no links. It must not count as a second group.
        every = connected_rows(self.problem.links, self.rows, self._used_between_rows)
        groups = [g for g in every if len(g) > 1 or g[0] in marked]
        # Groups that CAD points fix are connected to one another through C.
        together = [r for g in groups if self.points.place(g) for r in g.tolist()]
        apart = [g for g in groups if not self.points.place(g)]
        return sorted([np.array(sorted(together)), *apart] if together else apart, key=lambda g: int(g.min()))

    @cached_property
    def _used_between_rows(self) -> np.ndarray:
        return np.asarray((self.adjusted.weight > USED) & (self.problem.links.p != self.problem.links.q))

    @cached_property
    def unknown_rows(self) -> tuple[int, ...]:
        """Rows in which the position of the board is not known: only the belt's nominal speed predicts it.

        These are the rows of each group that has no CAD point and that no link connects with rows placed by CAD points.
        Rows beside such a group are added if a position in them has a standard deviation above `_PLACED_SIGMA_PX`, or
        if all that places them are too few links to connect them.
        """
        if self.mapping is None or not self.method.links:
            return ()
        main, with_points = self._rows_fixed_by_cad, set(self.points.row.tolist())
        groups = [set(g.tolist()) for g in self.connected_groups]
        unknown = {row for g in groups if not main & g and not with_points & g for row in g}
        o, used = self.problem.links, self._used_between_rows
        rows = np.bincount(o.p[used], minlength=self.rows) + np.bincount(o.q[used], minlength=self.rows)
        loose = set(np.flatnonzero(rows).tolist()) - with_points
        unknown |= loose.difference(*groups)
        vague = self.sigma.length_px > _PLACED_SIGMA_PX
        unknown |= set(self.sigma.seen_in[vague, 1].tolist()) - main
        return tuple(sorted(unknown & {row for _, row in self.scene.present}))

    @property
    def unplaceable(self) -> bool:
        """Whether no connected group of rows shows two CAD points: the position of the whole board is unknown."""
        apart = self.mapping is not None and self.method.links and len(self.connected_groups) > 1
        return apart and not self._rows_fixed_by_cad

    @cached_property
    def _rows_fixed_by_cad(self) -> set[int]:
        """The rows of those connected groups that have enough CAD points to be placed on the board by themselves."""
        return {row for g in self.connected_groups if self.points.place(g) for row in g.tolist()}

    @cached_property
    def seams_px(self) -> dict[tuple[int, int], float]:
        """For each pair of neighbouring cameras, the length of the median residual of their links, px (`seam_px`)."""
        seam = self.problem.links.seam
        at = np.flatnonzero(seam >= 0)
        every = (at[seam[at] == i] for i in range(len(self.scene.cameras) - 1))
        found = (seam_px(self.problem, self.adjusted, mine, _SEAM_LINKS) for mine in every)
        return {(i, i + 1): px for i, px in enumerate(found) if px is not None}

    @cached_property
    def displaced_cameras(self) -> tuple[tuple[int, Floats, tuple[int, ...]], ...]:
        """Cameras whose picture moved by more than `DISPLACED_PX`, rms over the frame, since the calibration.

        Each entry holds the camera, its displacement (3,) px, and the cameras that may have moved instead of it.
        """
        estimate = self.adjusted.cameras
        # If the run does not show a displacement clearly, none is reported, but σ contains it. The covariance does not
        # decide: it is large where two explanations name different cameras, although both are displaced.
        if estimate is None or estimate.fit(estimate.displacement_px) < _SIGNIFICANT**2:
            return ()
        # An error that the calibration leaves at the seams looks like a displacement.
        limits = [max(DISPLACED_PX, _SIGNIFICANT * seam_sigma_px(camera)) for camera in self.calibrated]
        each = enumerate(zip(estimate.displacement_px, limits, strict=True))
        # False links also suggest a displacement. It is accepted if the camera then agrees with at least one neighbour.
        agreeing = {camera for pair in set(self.seams_px) - self.seams_apart for camera in pair}
        unexplained = {camera for pair in self.seams_apart for camera in pair} - agreeing
        large = [i for i, (own, limit) in each if rms_displacement_px(own) > limit and i not in unexplained]
        return tuple((i, estimate.displacement_px[i], estimate.rivals) for i in large)

    @cached_property
    def lift(self) -> Lift | None:
        """Height of the board above the calibrated plane, from the overlaps if links fail there; None if unknown."""
        estimated = Lift(float(self.adjusted.surface_mm[0])) if len(self.adjusted.surface_mm) else None
        if not self.non_overlapping_pairs:
            return estimated
        # Where links fail, the adjustment's estimate comes from false links, or is just its prior.
        measured = measure_lift(replace(self.scene, cameras=self.calibrated), self.links)
        if measured is None:
            return estimated
        # One shifted overlap may also come from a displaced camera: the estimate by fiducials is preferred.
        alone = measured.overlaps == 1 and estimated is not None and self.mapping is not None
        return estimated if alone and estimated and abs(measured.mm - estimated.mm) > _OTHER_LIFT_MM else measured

    @property
    def far_off_plane(self) -> bool:
        """Whether several overlaps show the board too far off the calibrated plane, unlike the adjustment."""
        if self.lift is None or (self.lift.overlaps or 0) < 2 or abs(self.lift.mm) <= LIFT_LIMIT_MM:
            return False
        used = float(self.adjusted.surface_mm[0]) if len(self.adjusted.surface_mm) else 0.0
        return abs(self.lift.mm - used) > _OTHER_LIFT_MM

    @property
    def seams_apart(self) -> set[tuple[int, int]]:
        """The pairs of neighbouring cameras that disagree, even after correction of displacements."""
        return {pair for pair, px in self.seams_px.items() if px > SEAM_LIMIT_PX} | set(self.non_overlapping_pairs)

    @cached_property
    def non_overlapping_pairs(self) -> dict[tuple[int, int], int]:
        """Pairs of neighbouring cameras whose overlap has texture but too few matches, with the number of such rows."""
        seams = [e for e in self.links if e.task.kind == "neighbours"]
        out = {}
        for i, rows in sorted(Counter(e.task.a[0] for e in seams if e.unmatched).items()):
            # A failed match in a single row is no evidence of a moved camera.
            if rows >= 2 and (i, i + 1) not in self.seams_px:
                seam = [e for e in seams if e.task.a[0] == i]
                if agreeing_links(self.problem, self.adjusted, seam, i) < _SEAM_LINKS:
                    out[i, i + 1] = rows
        return out

    @cached_property
    def row_offsets(self) -> dict[tuple[int, int], int]:
        """For each pair of cameras whose rows do not match: the error, −1 or +1, of the second camera's row numbers."""
        found = {pair: row_offset(self.scene, self.links, pair[0]) for pair in sorted(self.seams_apart)}
        return {pair: offset for pair, offset in found.items() if offset}
