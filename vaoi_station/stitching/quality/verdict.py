"""The verdict on a stitch, and the numbers it rests on.

ok: every position is good to a third of a pixel by its own standard deviation, and nothing contradicts
the model. degraded: usable, with the reason. failed: component positions cannot be given.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status, Surface
from vaoi_station.stitching.adjustment.initial_motion import connected_rows
from vaoi_station.stitching.adjustment.motion import measured_velocity
from vaoi_station.stitching.adjustment.problem import FIXTURE, REFERENCE, AdjustmentResult, Problem
from vaoi_station.stitching.adjustment.surface import to_surface
from vaoi_station.stitching.board.cad_mapping import Mapping
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.fiducial_assignment import Frame, outside_share
from vaoi_station.stitching.board.footprints import Views, landmarks
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import Method
from vaoi_station.stitching.quality.absent_cameras import of_absent
from vaoi_station.stitching.quality.agreement import of_fiducials, of_outline, of_sightings
from vaoi_station.stitching.quality.covariances import matrix_sigmas, row_covariances
from vaoi_station.stitching.quality.heights import Height, component_heights
from vaoi_station.stitching.quality.uncertainty import Sigma, predicted_sigma, surface_sigma_mm

_OK_SIGMA_PX = 0.20
_SEAM_LIMIT_PX = 0.30
_FLOOR_LIMIT_PX = 0.30
_OUTSIDE_LIMIT = 0.03
_OUTLIER = 8.5
"""Points further off, in their standard deviations, have no weight (6 per axis)."""
_SAME_HEIGHT_PX = 0.5
"""Leads and body of a part differ by less, most of them."""
_SEAM_LINKS = 12
"""So many links between two cameras say whether they fit together."""


@dataclass(frozen=True, eq=False)
class Findings:
    """All that was found out about a run."""

    frame: Frame | None
    expectation: Expectation
    scene: Scene
    method: Method
    links: tuple[Links, ...]
    links_only: Problem
    moved: AdjustmentResult
    """The motion from links alone."""
    found: Mapping | Failure
    """The board, or why it was not found."""

    @property
    def mapping(self) -> Mapping | None:
        """The board, if it was found."""
        return self.found if isinstance(self.found, Mapping) else None

    @property
    def adjusted(self) -> AdjustmentResult:
        """The adjustment that counts."""
        return self.found.adjusted if isinstance(self.found, Mapping) else self.moved

    @property
    def problem(self) -> Problem:
        """What it solved."""
        return self.found.problem if isinstance(self.found, Mapping) else self.links_only

    @property
    def rows(self) -> int:
        """The paper's m."""
        return len(self.adjusted.motion.angle)

    @cached_property
    def sigma(self) -> Sigma:
        """Predicted standard deviations."""
        return predicted_sigma(self.scene, self.frame, self.adjusted, self.views)

    @cached_property
    def surface(self) -> Surface | None:
        """Of the board; None where it was not sought."""
        if self.frame is None or self.mapping is None or not len(self.adjusted.surface_mm):
            return None
        return to_surface(self.frame.board_type, self.adjusted.surface_mm)

    @cached_property
    def cad_matrix(self) -> Floats | None:
        """C, 3×3; None without."""
        c = self.adjusted.similarity
        return None if self.frame is None or self.mapping is None or c is None else self.frame.matrix(c)

    @cached_property
    def views(self) -> Views | None:
        """Of the components, or the board's corners; None without C."""
        if self.frame is None or self.cad_matrix is None:
            return None
        rows = self.adjusted.motion.rows_from_tester
        return Views.of(landmarks(self.frame)[1], self.cad_matrix, self.scene.cameras, rows, self.surface)

    @cached_property
    def heights(self) -> dict[str, Height]:
        """Of components above the board, by address, where their links tell."""
        if self.frame is None or self.mapping is None:
            return {}
        return component_heights(self.frame, self.problem, self.adjusted)

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


def judge(f: Findings) -> tuple[Status, tuple[str, ...]]:
    """Status and the reasons, in words and numbers; those of a failure begin with its cause."""
    if not f.scene.present:
        return Status.FAILED, ("no whole frame of any camera arrived: there is nothing to stitch",)
    if isinstance(f.found, Failure):
        absent = of_absent(f.scene, f.frame if f.method.marks else None, f.expectation, f.moved.motion)
        return Status.FAILED, (*absent, f.found.reason, *_complaints(f))
    complaints = _complaints(f)
    return (Status.DEGRADED if complaints else Status.OK), tuple(complaints)


def _complaints(f: Findings) -> list[str]:
    out = []
    if f.method.links and not any(len(e.a_px) for e in f.links):
        out.append("no texture was found in any frame: is there a board?")
    if len(f.tied) > 1:
        parts = ", ".join(f"{g.min()}–{g.max()}" for g in f.tied)
        out.append(f"nothing ties rows {parts} to one another: their distance is the belt's nominal one")
    if f.adjusted.floor_px > _FLOOR_LIMIT_PX:
        out.append(
            f"links scatter by {f.adjusted.floor_px:.2f} px (limit {_FLOOR_LIMIT_PX}): the board is not rigid or flat"
        )
    for (i, j), px in f.seams_px.items():
        if px > _SEAM_LIMIT_PX:
            out.append(
                f"cameras {i} and {j} disagree by {px:.2f} px (limit {_SEAM_LIMIT_PX}): "
                "a camera has moved, or the board is bent more than a board may"
            )
    for (i, j), rows in f.strangers.items():
        out.append(
            f"cameras {i} and {j} show different things where they should overlap (in {rows} rows): a camera has moved"
        )
    if f.frame is not None and f.mapping is not None and f.adjusted.similarity is not None:
        out += _cad_complaints(f, f.frame, f.mapping, f.adjusted.similarity)
    return out


def _cad_complaints(f: Findings, frame: Frame, mapping: Mapping, c: Floats) -> list[str]:
    out = []
    board_type = frame.board_type
    points = mapping.problem.fiducials
    which = points.which if points is not None else np.zeros(0, dtype=np.int_)
    seen = {int(w) for w in which if w >= 0}
    if not f.method.marks:
        seen = set(range(len(board_type.fiducials)))
    for n, fiducial in enumerate(board_type.fiducials):
        if n not in seen and len(seen) < 2 and not (which < 0).any():
            out.append(f"fiducial {fiducial.name} was not found; one alone does not fix the board")
    resolution = float(np.mean([camera.px_per_mm for camera in f.scene.cameras]))
    out += of_fiducials(frame, f.adjusted, points, f.moved.motion, resolution) + of_outline(mapping.shift, resolution)
    if mapping.either_way:
        out.append(
            "turned by 180° the board would fit its fiducials as well, and neither outline nor parts tell: "
            "it is taken to lie as expected (a third fiducial off the symmetry would settle it)"
        )
    if mapping.outline is not None and not mapping.outline.visible:
        out.append(
            f"there is no edge where the board's outline should be (contrast {mapping.outline.contrast:.1f} "
            f"grey levels over {mapping.outline.pieces} places): it is another type, or lies elsewhere"
        )
    o = f.problem.links
    use = (f.adjusted.weight > 0.5) & (o.p != o.q)
    off_board = outside_share(frame, c, f.adjusted.motion.board(o.p[use], o.a_mm[use]))
    if off_board > _OUTSIDE_LIMIT:
        out.append(
            f"{off_board:.0%} of the texture lies off the board (limit {_OUTSIDE_LIMIT:.0%}): another type, or turned?"
        )
    worst = f.sigma.worst_px
    if worst is not None and worst > _OK_SIGMA_PX:
        blamed = of_sightings(frame, points, _OK_SIGMA_PX)
        out.append(f"positions are uncertain by {worst:.2f} px (1 σ, limit {_OK_SIGMA_PX}){blamed}")
    return out


def quality_of(f: Findings) -> dict[str, Any]:
    """The numbers behind the verdict."""
    a = f.adjusted
    sigma = f.sigma
    velocity = None
    if f.tied:
        group = max(f.tied, key=len)
        velocity = measured_velocity(a.motion, f.problem.times_s, group)
    nominal = float(np.hypot(*f.problem.velocity_mm_s))
    used, rows = a.weight > 0.1, row_covariances(a)
    return {
        "links": {
            kind: {"found": int(mine.sum()), "used": int((mine & used).sum())}
            for kind, mine in (("rows", f.seam < 0), ("neighbours", f.seam >= 0))
        }
        | _points_used(f),
        "unlinked": [
            {"a": list(e.task.a), "b": list(e.task.b or ()), "reason": e.note} for e in f.links if not len(e.a_px)
        ],
        "residual_px": {
            "median": _rounded(float(np.sqrt(np.median((a.link_px**2).sum(1)[used])))) if used.any() else None,
            "scatter": _rounded(a.floor_px),
            "sigma0": _rounded(a.sigma0),
        },
        "seams_px": {f"{i}-{j}": _rounded(v) for (i, j), v in f.seams_px.items()},
        "fiducials": _fiducials(f),
        "scale_error": _scale_error(f),
        "outline_contrast": _rounded(f.mapping.outline.contrast, 1) if f.mapping and f.mapping.outline else None,
        "outline_shift_mm": _shift_of(f),
        "row_sigma_px": [_rounded(v) for v in sigma.rows_px],
        "cad_sigma_px": _rounded(sigma.worst_px) if sigma.worst_px is not None else None,
        "component_sigma_px": _component_sigma(f),
        "pivot_mm": [_rounded(float(v)) for v in a.motion.pivot],
        "row_covariance": [[[_significant(v) for v in r] for r in c] for c in rows.tolist()],
        "matrix_sigma_px": [
            [pair if placed else None for pair, placed in zip(camera, f.placed, strict=True)]
            for camera in np.round(matrix_sigmas(f.scene.cameras, a.motion.pivot, rows), 4).tolist()
        ],
        "component_covariance_px2": sigma.told() if f.frame and f.frame.board_type.components else {},
        "surface_sigma_mm": _surface_sigma(f),
        "heights_mm": {address: _rounded(h.mm) for address, h in f.heights.items()},
        "height_sigma_mm": {address: _rounded(h.sigma_mm) for address, h in f.heights.items()},
        "belt": {
            "nominal_mm_s": [float(v) for v in f.problem.velocity_mm_s],
            "measured_mm_s": None if velocity is None else [_rounded(float(v)) for v in velocity],
            "speed_error": None if velocity is None else _rounded(float(np.hypot(*velocity)) / nominal - 1, 6),
        },
    }


def _points_used(f: Findings) -> dict[str, dict[str, int]]:
    """How many points known in CAD were found, and how many lie where they should, by kind."""
    points = f.mapping.problem.fiducials if f.mapping else None
    which, off = np.zeros(0, dtype=np.int_), np.zeros(0)
    if points is not None:
        which = points.which
        off = np.hypot(*f.adjusted.fiducial_px.T) / (points.sigma_mm * points.px_per_mm)
    kinds = {"fiducials": which >= 0, "fixture": which == FIXTURE, "reference": which == REFERENCE}
    return {
        kind: {"found": int(mine.sum()), "used": int((mine & (off <= _OUTLIER)).sum())} for kind, mine in kinds.items()
    }


def _fiducials(f: Findings) -> list[dict[str, Any]]:
    mapping = f.mapping
    if f.frame is None or mapping is None:
        return []
    out = []
    points = mapping.problem.fiducials
    which = points.which if points is not None else np.zeros(0, dtype=np.int_)
    for n, fiducial in enumerate(f.frame.board_type.fiducials):
        at = np.flatnonzero(which == n)
        residual = f.adjusted.fiducial_px[at].mean(0) if len(at) else None
        out.append(
            {
                "name": fiducial.name,
                "sightings": len(at),
                "residual_px": None if residual is None else [_rounded(float(v)) for v in residual],
            }
        )
    return out


def _shift_of(f: Findings) -> dict[str, Any] | None:
    shift = f.mapping.shift if f.mapping else None
    if shift is None:
        return None
    return {
        "mm": [_rounded(float(v), 3) for v in shift.mm],
        "sigma_mm": [_rounded(float(v), 3) for v in shift.sigma_mm],
        "turn_mrad": _rounded(1e3 * shift.turn_rad, 3),
        "turn_sigma_mrad": _rounded(1e3 * shift.turn_sigma_rad, 3),
        "pieces": shift.pieces,
    }


def _component_sigma(f: Findings) -> dict[str, float]:
    """Predicted standard deviation of every component that is in view, by address: the worst of its views."""
    return f.sigma.of_components if f.frame and f.mapping and f.frame.parts.addresses else {}


def _surface_sigma(f: Findings) -> float | None:
    """Of the board's height, at its middle and corners the worst; None where it was not sought."""
    if f.frame is None or not len(f.adjusted.surface_mm):
        return None
    low, high = f.frame.board_type.extent()
    places = np.array([(low + high) / 2, low, high, (low[0], high[1]), (high[0], low[1])])
    return _rounded(float(surface_sigma_mm(f.frame, f.adjusted, places).max()))


def _scale_error(f: Findings) -> float | None:
    if f.frame is None or f.adjusted.similarity is None:
        return None
    a, b = f.adjusted.similarity[:2]
    return _rounded(float(np.hypot(a, b)) / f.frame.board_type.mm_per_unit - 1, 7)


def _significant(value: float) -> float:
    """Variances are small: four digits, wherever the point."""
    return float(f"{value:.4g}")


def _rounded(value: float, digits: int = 4) -> float:
    return round(value, digits)
