"""All findings of the stitching of a run, from which verdict, quality numbers and report are derived."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.displacement import rms_displacement_px
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.candidate_search import SURROUND
from vaoi_station.model import VISIBILITY, Surface, Visibility
from vaoi_station.stitching.adjustment.initial_motion import connected_rows
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.adjustment.surface import to_surface
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.footprints import FootprintViews, landmarks
from vaoi_station.stitching.matching.evidence import FrameKey, Links
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import Method
from vaoi_station.stitching.quality.covariances import largest_sigma
from vaoi_station.stitching.quality.heights import Height, component_heights
from vaoi_station.stitching.quality.lens_errors import LensError, lens_errors
from vaoi_station.stitching.quality.reference_share import reference_share, with_camera_errors, with_common_error
from vaoi_station.stitching.quality.row_offsets import row_offset
from vaoi_station.stitching.quality.seam_causes import LIFT_LIMIT_MM, Lift, measure_lift
from vaoi_station.stitching.quality.uncertainty import PredictedSigma, predict_sigma, seam_sigma_px
from vaoi_station.stitching.quality.unseen import FilmedBoard, SeenFrames, UnseenComponent, find_unseen

_USED = 0.1
"""Weight above which a link counts as used."""
_SAME_HEIGHT_PX = 0.5
"""Largest difference, in px at the seam, between a component's height by links across the seam and by other links."""
SEAM_LIMIT_PX = 0.30
"""Largest disagreement of two cameras at their seam, px."""
DISPLACED_PX = 0.20
"""Largest displacement of a camera since its calibration, rms over the frame, that is corrected without a reason."""
_SIGNIFICANT = 4.0
"""Standard deviations from which on the displacements of all cameras together are significant."""
_PLACED_SIGMA_PX = 2.0
"""Largest standard deviation of a position in a row that neither links nor points of the CAD data tie to the others."""
_OTHER_LIFT_MM = 1.0
"""Least difference of a lift measured by overlaps from that of the adjustment at which the two contradict."""
_LEAST_FITTING, _LEAST_SHARE, _SURELY = 3, 0.25, 5
"""Least number and share of a frame's links that must fit, or number of links that do not fit by chance. Of sound
frames of the recordings and of the twin 0.7 or more fit; one link of a repeated frame may fit by chance."""
_BORDER_PX = 6.0
"""Distance from a frame's border within which the bare rim of a fiducial must not reach, so that it is detected."""
_SEAM_LINKS = 12
"""Least number of links between two cameras that show whether the cameras agree."""


@dataclass(frozen=True, eq=False)
class Findings:
    """The inputs and solutions of the stitching of one run. Derived values are computed when first read."""

    plane: BoardPlane | None
    expectation: Expectation
    scene: Scene
    method: Method
    links: tuple[Links, ...]
    moved: AdjustmentResult
    """The solution of the adjustment without CAD data."""
    calibrated: tuple[Camera, ...]
    """The cameras as calibrated. Those of `scene` are the displaced cameras of the adjustment."""
    found: CadMapping | Failure
    """The CAD mapping of the board, or the failure that says why the board was not found."""
    visibility: Visibility = VISIBILITY
    """How much of every component the frames must show, unless the board type asks for something else."""
    reference_sigma_px: float = 0.0
    """Standard deviation of positions by the CAD mapping of the reference; 0 without a reference."""
    unplaced: tuple[int, ...] = ()
    """Rows with good frames that are not placed, because nothing shows where the board was; not part of `scene`."""
    copies: frozenset[FrameKey] = frozenset()
    """Good frames that equal the frame before them in every pixel: they were not filmed in their rows."""

    @property
    def mapping(self) -> CadMapping | None:
        """The CAD mapping of the board; None if the board was not found."""
        return self.found if isinstance(self.found, CadMapping) else None

    @property
    def adjusted(self) -> AdjustmentResult:
        """The final solution: that of the CAD mapping if the board was found, else that of the links alone."""
        return self.found.adjusted if isinstance(self.found, CadMapping) else self.moved

    @property
    def problem(self) -> Problem:
        """The adjustment problem of which `adjusted` is the solution, as the displaced cameras see it."""
        return self.adjusted.problem

    @property
    def rows(self) -> int:
        """Number of rows (m in the paper)."""
        return len(self.adjusted.motion.angle)

    @cached_property
    def sigma(self) -> PredictedSigma:
        """Predicted standard deviations of component positions and rows."""
        predicted = predict_sigma(self.scene, self.plane, self.adjusted, self.views)
        share = reference_share(self.problem.fiducials, self.adjusted.fiducial_px) * self.reference_sigma_px
        predicted = with_common_error(predicted, share) if share > 0 else predicted
        return with_camera_errors(predicted, {i: error.position_px for i, error in self.lens_errors.items()})

    @cached_property
    def lens_errors(self) -> dict[int, LensError]:
        """Radial errors of the cameras' pictures against their calibration, by camera; empty without C."""
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
    def cad_matrix(self) -> Floats | None:
        """C as a 3×3 matrix; None without a CAD mapping."""
        c = self.adjusted.similarity
        return None if self.plane is None or self.mapping is None or c is None else self.plane.matrix(c)

    @cached_property
    def views(self) -> FootprintViews | None:
        """Views of the components, or of two board corners if there are no components; None without C."""
        if self.plane is None or self.cad_matrix is None:
            return None
        rows = self.adjusted.motion.rows_from_tester
        views = FootprintViews.of(landmarks(self.plane)[1], self.cad_matrix, self.scene.cameras, rows, self.surface)
        return views.without_rows(self.unplaced) if self.unplaced else views

    @cached_property
    def fiducials_in_view(self) -> dict[int, FrameKey]:
        """The fiducials that frames show with their bare rim, by number, each with one of the frames; empty without C.

        Only frames whose pictures fit the board's motion count.
        """
        if self.plane is None or self.cad_matrix is None:
            return {}
        fiducials, rows = self.plane.board_type.fiducials, self.adjusted.motion.rows_from_tester
        at = np.array([(f.x, f.y) for f in fiducials]).reshape(-1, 2)
        views = FootprintViews.of(at, self.cad_matrix, self.scene.cameras, rows, self.surface)
        found: dict[int, FrameKey] = {}
        for n, i, j, px in zip(views.point.tolist(), views.camera.tolist(), views.row.tolist(), views.px, strict=True):
            camera = self.scene.cameras[i]
            reach_px = SURROUND / 2 * fiducials[n].diameter * self.plane.board_type.mm_per_unit * camera.px_per_mm
            if (i, j) in self.confirmed and camera.sees(px[None], reach_px + _BORDER_PX)[0]:
                found.setdefault(n, (i, j))
        return found

    @cached_property
    def confirmed(self) -> frozenset[FrameKey]:
        """The good frames whose pictures fit the board's motion: by their links, or by a point with CAD coordinates.

        A few links of a frame may fit by chance: a share of them must. A frame that is black, covered or repeated is
        complete and fits nothing: it shows no component.
        """
        if not self.method.links:
            # without links there is nothing that could confirm a frame between two fiducials
            return frozenset(self.scene.present) - self.copies
        o, points = self.problem.links, self.problem.fiducials
        every = np.bincount(o.group, minlength=len(o.groups))
        used = np.bincount(o.group[self.adjusted.weight > _USED], minlength=len(o.groups))
        linked: defaultdict[FrameKey, list[int]] = defaultdict(lambda: [0, 0])
        for links, own, fitting in zip(o.groups, every.tolist(), used.tolist(), strict=True):
            for key in (links.task.a, links.task.b):
                if key is not None:
                    linked[key][0] += own
                    linked[key][1] += fitting
        # of a frame at the end of the board, most links may lie on a textured belt
        frames = {
            key
            for key, (own, fits) in linked.items()
            if fits >= _SURELY or (fits >= _LEAST_FITTING and fits > _LEAST_SHARE * own)
        }
        if points is not None:
            frames |= set(zip(points.camera.tolist(), points.row.tolist(), strict=True))
        return frozenset(frames & set(self.scene.present) - self.copies)

    @cached_property
    def unconfirmed(self) -> tuple[FrameKey, ...]:
        """The good frames that should show the centre of a component, and whose pictures fit nothing, in order."""
        views = self.views
        if views is None:
            return ()
        seen = set(zip(views.camera.tolist(), views.row.tolist(), strict=True))
        return tuple(sorted((seen & set(self.scene.present)) - self.confirmed))

    @cached_property
    def unseen(self) -> tuple[UnseenComponent, ...]:
        """The components that the good frames show too little of; empty without C."""
        if self.plane is None or self.cad_matrix is None:
            return ()
        rows = self.adjusted.motion.rows_from_tester
        board = FilmedBoard(
            self.plane.board_type, self.plane.components, self.cad_matrix, self.scene.cameras, rows, self.surface
        )
        frames = SeenFrames(self.scene.present, self.confirmed)
        return find_unseen(board, frames, self.problem.velocity_mm_s, self.visibility)

    @cached_property
    def heights(self) -> dict[str, Height]:
        """Heights of components above the board, by address. Components without enough links are left out."""
        if self.plane is None or self.mapping is None:
            return {}
        return component_heights(self.plane, self.problem, self.adjusted)

    @cached_property
    def placed(self) -> tuple[bool, ...]:
        """For each row, whether it has at least one good frame. A row without good frames has no image matrices."""
        rows = {row for _, row in self.scene.present}
        return tuple(j in rows for j in range(self.rows))

    @cached_property
    def connected_groups(self) -> list[np.ndarray]:
        """Groups of rows that are connected by links or CAD points. Rows without texture belong to no group."""
        o = self.problem.links
        used = (self.adjusted.weight > _USED) & (o.p != o.q)
        linked = set(np.flatnonzero(np.bincount(np.append(o.p[used], o.q[used]), minlength=self.rows)).tolist())
        if self.problem.fiducials is not None:
            linked |= set(self.problem.fiducials.row.tolist())
        # A row that shows only the belt, before or after the board, has no links. It must not count as a second group.
        groups = [g for g in connected_rows(o, self.rows, used) if any(r in linked for r in g)]
        fixed = [self._fixed_by_cad(g) for g in groups]
        # Groups that CAD points fix are connected to one another through C.
        together = [r for g, by_cad in zip(groups, fixed, strict=True) if by_cad for r in g.tolist()]
        apart = [g for g, by_cad in zip(groups, fixed, strict=True) if not by_cad]
        return sorted([np.array(sorted(together)), *apart] if together else apart, key=lambda g: int(g.min()))

    def _fixed_by_cad(self, rows: np.ndarray) -> bool:
        """Return whether at least two points with known CAD coordinates place these rows, without any links."""
        points = self.problem.fiducials
        if points is None:
            return False
        return len(np.unique(points.cad[np.isin(points.row, rows)], axis=0)) >= 2

    @cached_property
    def unknown_rows(self) -> tuple[int, ...]:
        """Rows whose place is not known: only the belt's nominal speed gives it, and belts stop or slow down.

        These are groups of rows that no link connects to the rows which CAD points place, and which have no CAD point
        of their own, and rows beside those groups in which a position is uncertain by more than `_PLACED_SIGMA_PX`.
        """
        if self.mapping is None or not self.method.links:
            return ()
        main = self._rows_fixed_by_cad
        points = self.problem.fiducials
        with_points = set(points.row.tolist()) if points is not None else set()
        unknown = {
            row
            for g in self.connected_groups
            if not main & set(g.tolist()) and not with_points & set(g.tolist())
            for row in g.tolist()
        }
        vague = largest_sigma(self.sigma.covariance_px2) > _PLACED_SIGMA_PX
        unknown |= set(self.sigma.seen_in[vague, 1].tolist()) - main
        return tuple(sorted(unknown & {row for _, row in self.scene.present}))

    @property
    def unplaceable(self) -> bool:
        """Whether no rows that are connected show two CAD points: the place of the whole board is then unknown."""
        several = self.mapping is not None and self.method.links and len(self.connected_groups) > 1
        return several and not self._rows_fixed_by_cad

    @cached_property
    def _rows_fixed_by_cad(self) -> set[int]:
        """The rows of the groups that fiducials or reference points place on the board without any other group."""
        return {row for g in self.connected_groups if self._fixed_by_cad(g) for row in g.tolist()}

    @cached_property
    def seam_of_link(self) -> np.ndarray:
        """(k,) for each link across a seam the lower number of its two cameras; −1 for links from row to row."""
        o = self.problem.links
        left = [e.task.a[0] if e.task.kind == "neighbours" else -1 for e in o.groups]
        return np.array(left, dtype=np.int_)[o.group]

    @cached_property
    def seams_px(self) -> dict[tuple[int, int], float]:
        """Length, px, of the median residual of links on the bare board, by pair of neighbouring cameras.

        A large value means that a camera has moved, or that the board has a shape outside the surface model.
        """
        # Links on components are left out, since the height of a component is no error of the seam.
        bare = np.flatnonzero((self.seam_of_link >= 0) & (self.problem.component < 0))
        seam, off_px, out = self.seam_of_link[bare], self.adjusted.link_px[bare], {}
        for i in range(len(self.scene.cameras) - 1):
            mine = off_px[seam == i]
            if len(mine) >= _SEAM_LINKS:
                out[i, i + 1] = float(np.hypot(*np.median(mine, axis=0)))
        return out

    @cached_property
    def displaced_cameras(self) -> tuple[tuple[int, Floats, tuple[int, ...]], ...]:
        """Cameras whose picture moved by more than `DISPLACED_PX`, rms over the frame, since the calibration.

        Each is given with its displacement (3,) px and the cameras that may have moved instead.
        """
        estimate = self.adjusted.cameras
        if estimate is None:
            return ()
        # a displacement that the run does not show is no finding: σ of the positions includes it. The covariance is not
        # used for that, since it is wide where two explanations name different cameras, both of them displaced
        d = estimate.displacement_px.ravel()
        explained = float(2 * d @ estimate.vector - d @ estimate.information @ d)
        if explained < _SIGNIFICANT**2:
            return ()
        # what the calibration leaves open at the seams looks like a displacement
        limits = [max(DISPLACED_PX, _SIGNIFICANT * seam_sigma_px(camera)) for camera in self.calibrated]
        each = zip(estimate.displacement_px, limits, strict=True)
        large = [
            i for i, (own, limit) in enumerate(each) if rms_displacement_px(own) > limit and i not in self._unexplained
        ]
        return tuple((i, estimate.displacement_px[i], estimate.rivals) for i in large)

    @cached_property
    def lift(self) -> Lift | None:
        """Height of the board above the calibrated plane, by the overlaps if links fail there; None: unknown."""
        estimated = Lift(float(self.adjusted.surface_mm[0])) if len(self.adjusted.surface_mm) else None
        if not self.non_overlapping_pairs:
            return estimated
        # Where links fail, the estimate is that of false links, or its own prior.
        measured = measure_lift(replace(self.scene, cameras=self.calibrated), self.links)
        if measured is None:
            return estimated
        # One overlap may also be shifted by a displaced camera; fiducials that were found decide.
        alone = measured.overlaps == 1 and estimated is not None and self.mapping is not None
        return estimated if alone and estimated and abs(measured.mm - estimated.mm) > _OTHER_LIFT_MM else measured

    @property
    def far_off_plane(self) -> bool:
        """Whether several overlaps show another height, beyond its limit, than that with which positions were found."""
        if self.lift is None or (self.lift.overlaps or 0) < 2 or abs(self.lift.mm) <= LIFT_LIMIT_MM:
            return False
        used = float(self.adjusted.surface_mm[0]) if len(self.adjusted.surface_mm) else 0.0
        return abs(self.lift.mm - used) > _OTHER_LIFT_MM

    @cached_property
    def _unexplained(self) -> set[int]:
        """Cameras that disagree with a neighbour in spite of their estimated displacements, and agree with none."""
        apart = {pair for pair, px in self.seams_px.items() if px > SEAM_LIMIT_PX} | set(self.non_overlapping_pairs)
        agreeing = {camera for pair in set(self.seams_px) - apart for camera in pair}
        # false links suggest a displacement, too: it is believed if it leaves a seam of the camera without a residual
        return {camera for pair in apart for camera in pair} - agreeing

    @cached_property
    def _usable_seam_links(self) -> np.ndarray:
        """(k,) whether each link can be evidence that two neighbouring cameras agree."""
        o, component = self.problem.links, self.problem.component
        rows, seam = self.adjusted.heights_mm
        if not len(rows):
            return component < 0
        # On a component, its estimated height explains any residual across the seam. Such links count only if
        # links from row to row give the same height.
        off_px = np.abs(seam - rows)[component] * np.hypot(*(o.b_lean - o.a_lean).T) * o.px_per_mm
        return np.asarray((component < 0) | (off_px < _SAME_HEIGHT_PX))

    @cached_property
    def non_overlapping_pairs(self) -> dict[tuple[int, int], int]:
        """Pairs of neighbouring cameras whose overlap has texture that does not match, with the number of such rows."""
        unmatched = Counter(e.task.a[0] for e in self.links if e.task.kind == "neighbours" and e.unmatched)
        out = {}
        for i, rows in sorted(unmatched.items()):
            # A failed match in a single row is no evidence of a moved camera.
            if rows >= 2 and (i, i + 1) not in self.seams_px:
                agreeing = (self.seam_of_link == i) & (self.adjusted.weight > _USED) & self._usable_seam_links
                if agreeing.sum() < _SEAM_LINKS:
                    out[i, i + 1] = rows
        return out

    @cached_property
    def row_offsets(self) -> dict[tuple[int, int], int]:
        """Pairs of cameras that disagree, of which the second is in rows too high by the value: −1 or +1."""
        apart = {pair for pair, px in self.seams_px.items() if px > SEAM_LIMIT_PX} | set(self.non_overlapping_pairs)
        found = {pair: row_offset(self.scene, self.links, pair[0]) for pair in sorted(apart)}
        return {pair: offset for pair, offset in found.items() if offset}
