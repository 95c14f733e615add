"""What the stitching found out about a run; the verdict and the quality document read from it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Surface
from vaoi_station.stitching.adjustment.initial_motion import connected_rows
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.adjustment.surface import to_surface
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.footprints import FootprintViews, landmarks
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import Method
from vaoi_station.stitching.quality.heights import Height, component_heights
from vaoi_station.stitching.quality.uncertainty import PredictedSigma, predict_sigma

_SAME_HEIGHT_PX = 0.5
"""Leads and body of a part differ by less, most of them."""
_SEAM_LINKS = 12
"""So many links between two cameras say whether they fit together."""


@dataclass(frozen=True, eq=False)
class Findings:
    """All that was found out about a run."""

    plane: BoardPlane | None
    expectation: Expectation
    scene: Scene
    method: Method
    links: tuple[Links, ...]
    links_only: Problem
    moved: AdjustmentResult
    """The motion from links alone."""
    found: CadMapping | Failure
    """The board, or why it was not found."""

    @property
    def mapping(self) -> CadMapping | None:
        """The board, if it was found."""
        return self.found if isinstance(self.found, CadMapping) else None

    @property
    def adjusted(self) -> AdjustmentResult:
        """The adjustment that counts."""
        return self.found.adjusted if isinstance(self.found, CadMapping) else self.moved

    @property
    def problem(self) -> Problem:
        """What it solved."""
        return self.found.problem if isinstance(self.found, CadMapping) else self.links_only

    @property
    def rows(self) -> int:
        """The paper's m."""
        return len(self.adjusted.motion.angle)

    @cached_property
    def sigma(self) -> PredictedSigma:
        """Predicted standard deviations."""
        return predict_sigma(self.scene, self.plane, self.adjusted, self.views)

    @cached_property
    def surface(self) -> Surface | None:
        """Of the board; None where it was not sought."""
        if self.plane is None or self.mapping is None or not len(self.adjusted.surface_mm):
            return None
        return to_surface(self.plane.board_type, self.adjusted.surface_mm)

    @cached_property
    def cad_matrix(self) -> Floats | None:
        """C, 3×3; None without."""
        c = self.adjusted.similarity
        return None if self.plane is None or self.mapping is None or c is None else self.plane.matrix(c)

    @cached_property
    def views(self) -> FootprintViews | None:
        """Of the components, or the board's corners; None without C."""
        if self.plane is None or self.cad_matrix is None:
            return None
        rows = self.adjusted.motion.rows_from_tester
        return FootprintViews.of(landmarks(self.plane)[1], self.cad_matrix, self.scene.cameras, rows, self.surface)

    @cached_property
    def heights(self) -> dict[str, Height]:
        """Of components above the board, by address, where their links tell."""
        if self.plane is None or self.mapping is None:
            return {}
        return component_heights(self.plane, self.problem, self.adjusted)

    @cached_property
    def placed(self) -> tuple[bool, ...]:
        """Rows with at least one good frame; of the others there is nothing to place."""
        rows = {row for _, row in self.scene.present}
        return tuple(j in rows for j in range(self.rows))

    @cached_property
    def tied(self) -> list[np.ndarray]:
        """Groups of rows that links tie together, of those rows that show texture."""
        o = self.problem.links
        used = (self.adjusted.weight > 0.1) & (o.p != o.q)
        linked = set(np.flatnonzero(np.bincount(np.append(o.p[used], o.q[used]), minlength=self.rows)).tolist())
        if self.problem.fiducials is not None:
            linked |= set(self.problem.fiducials.row.tolist())
        groups = [g for g in connected_rows(o, self.rows, used) if any(r in linked for r in g)]
        fixed = [self._fixed_by_cad(g) for g in groups]
        together = [r for g, by_cad in zip(groups, fixed, strict=True) if by_cad for r in g.tolist()]
        apart = [g for g, by_cad in zip(groups, fixed, strict=True) if not by_cad]
        return sorted([np.array(sorted(together)), *apart] if together else apart, key=lambda g: int(g.min()))

    def _fixed_by_cad(self, rows: np.ndarray) -> bool:
        """Whether points known in CAD, two or more, fix these rows by themselves."""
        points = self.problem.fiducials
        if points is None:
            return False
        return len(np.unique(points.cad[np.isin(points.row, rows)], axis=0)) >= 2

    @cached_property
    def seam(self) -> np.ndarray:
        """(k,) the left one of the two neighbouring cameras that a link joins, −1 for links from row to row."""
        o = self.problem.links
        left = [e.task.a[0] if e.task.kind == "neighbours" else -1 for e in o.groups]
        return np.array(left, dtype=np.int_)[o.group]

    @cached_property
    def seams_px(self) -> dict[tuple[int, int], float]:
        """Median misfit between neighbouring cameras of one row, on the bare board: height or a moved camera."""
        bare = np.flatnonzero((self.seam >= 0) & (self.problem.component < 0))
        seam, off_px, out = self.seam[bare], self.adjusted.link_px[bare], {}
        for i in range(len(self.scene.cameras) - 1):
            mine = off_px[seam == i]
            if len(mine) >= _SEAM_LINKS:
                out[i, i + 1] = float(np.hypot(*np.median(mine, axis=0)))
        return out

    @cached_property
    def _vouching(self) -> np.ndarray:
        """Links that may say that two cameras fit together: (k,) truth values.

        On the bare board all may. On a part a height of its own explains whatever they say across the seam, so it
        must be the height that is seen from row to row.
        """
        o, part = self.problem.links, self.problem.component
        rows, seam = self.adjusted.heights_mm
        if not len(rows):
            return part < 0
        off_px = np.abs(seam - rows)[part] * np.hypot(*(o.b_lean - o.a_lean).T) * o.px_per_mm
        return np.asarray((part < 0) | (off_px < _SAME_HEIGHT_PX))

    @cached_property
    def strangers(self) -> dict[tuple[int, int], int]:
        """Neighbouring cameras whose overlap shows texture, but not the same, and in how many rows."""
        unmatched = Counter(e.task.a[0] for e in self.links if e.task.kind == "neighbours" and e.unmatched)
        out = {}
        for i, rows in sorted(unmatched.items()):
            if rows >= 2 and (i, i + 1) not in self.seams_px:
                agreeing = (self.seam == i) & (self.adjusted.weight > 0.1) & self._vouching
                if agreeing.sum() < _SEAM_LINKS:
                    out[i, i + 1] = rows
        return out
