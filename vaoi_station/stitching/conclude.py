"""From evidence to a result: motion, CAD mapping, heights, verdict; reads from top to bottom.

The order is that of section 3.3: first the motion of the rows from links alone, then the board's
fiducials on it, then everything together in one adjustment.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status, Stitch
from vaoi_station.stitching.adjustment.initial_motion import chain_links
from vaoi_station.stitching.adjustment.mark_links import mark_links
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.adjustment.observations import LinkStore, Observations, to_observations
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem
from vaoi_station.stitching.adjustment.solver import adjust, evaluate_at, solve_subsampled
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import MappingInputs, map_cad
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.footprints import views_by_address
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.matching.evidence import Detections, Evidence, Links
from vaoi_station.stitching.matching.scene import Scene
from vaoi_station.stitching.method import METHODS
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.quality_document import quality_document
from vaoi_station.stitching.quality.verdict import decide_verdict
from vaoi_station.version import __version__

_MOTION_MM = 5e-4
"""So far the motion from links alone converges at first: where the board is found all is adjusted once more."""
_TEXTURE = 4000
"""So many places tell as well as all which share of them lies off the board."""
NO_BOARD_TYPE = Failure("no board type was given, so there is no CAD mapping")


@dataclass
class Stages:
    """How long the stages took, in ms of wall time."""

    ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def done(self, name: str) -> None:
        """The stage of that name has just ended."""
        now = time.perf_counter()
        self.ms[name] = round((now - self._last) * 1e3, 3)
        self._last = now


@dataclass(frozen=True, eq=False)
class PriorKnowledge:
    """What was known before the board was filmed."""

    plane: BoardPlane | None
    """Of the board type that is on the belt; None leaves C out."""
    expectation: Expectation
    velocity_mm_s: Floats
    """(2,) nominal."""
    method: str
    reference: Reference | None = None


def conclude(
    scene: Scene, prior: PriorKnowledge, times_s: Floats, evidence: Sequence[Evidence], link_store: LinkStore
) -> tuple[Stitch, Findings]:
    """Make the result of a run from the evidence of its frames; the findings say how it came about.

    Args:
        scene: cameras and good frames.
        terms: what was known before.
        times_s: (m,) time of every row.
        evidence: of the canonical tasks, in any order.
        link_store: in which its links may have been entered.
    """
    stages, velocity_mm_s = Stages(), prior.velocity_mm_s
    order = sorted(evidence, key=lambda e: (e.task.a, e.task.b or (-1, -1), e.task.kind))
    detections = tuple(e for e in order if isinstance(e, Detections))
    links = tuple(e for e in order if isinstance(e, Links) and e.task.kind != "reference")
    referred = tuple(e for e in order if isinstance(e, Links) and e.task.kind == "reference")
    method = METHODS[prior.method]
    observed = link_store.observations(links)
    pivot = np.mean([c.row_from_image(c.center_px) for c in scene.cameras], axis=0)
    nominal = nominal_motion(times_s, velocity_mm_s, pivot)
    problem = Problem(times_s, velocity_mm_s, observed, np.full(len(observed), -1))
    if method.links:
        start = chain_links(nominal, observed)
        rough = solve_subsampled(problem, start)
        moved = adjust(problem, start, converged_mm=_MOTION_MM) if rough is None else evaluate_at(problem, rough)
    else:
        by_marks = to_observations(mark_links(detections, scene.cameras, nominal), scene.cameras)
        moved = adjust(
            replace(problem, links=by_marks, component=np.full(len(by_marks), -1)), chain_links(nominal, by_marks)
        )
    texture = _texture(observed, moved) if method.links else np.zeros((0, 2))
    stages.done("motion")

    plane = prior.plane
    known = MappingInputs(prior.expectation, method, detections, texture, prior.reference, referred)
    found = NO_BOARD_TYPE if plane is None else map_cad(plane, scene, problem, moved, known)
    if isinstance(found, Failure) and method.links:
        moved = adjust(problem, moved.motion)
    stages.done("cad")
    findings = Findings(plane, prior.expectation, scene, method, links, problem, moved, found)
    status, reasons = decide_verdict(findings)
    quality = quality_document(findings) | {
        "timings_ms": stages.ms,
        "software": f"vaoi_station {__version__}",
        **({"reference": prior.reference.name} if prior.reference is not None and method.reference else {}),
        "opencv": cv2.__version__,
    }
    stages.done("verdict")
    return _result(findings, prior.method, status, reasons, quality), findings


def _texture(links: Observations, moved: AdjustmentResult) -> Floats:
    """Places on the board that were linked from row to row and move as the board does; of many some."""
    use = np.flatnonzero((moved.weight > 0.5) & (links.p != links.q))
    use = use[:: max(len(use) // _TEXTURE, 1)]
    return moved.motion.board(links.p[use], links.a_mm[use])


def _result(
    findings: Findings, method: str, status: Status, reasons: tuple[str, ...], quality: dict[str, Any]
) -> Stitch:
    rows, placed = findings.adjusted.motion.rows_from_tester, findings.placed
    matrix, components = findings.cad_matrix, None
    if findings.plane is not None and findings.views is not None:
        addresses = findings.plane.components.addresses
        components = views_by_address(addresses, findings.views) if addresses else {}
    images = (
        tuple(
            m if there else None for m, there in zip(_fixed(camera.image_from_row.matrix @ rows), placed, strict=True)
        )
        for camera in findings.scene.cameras
    )
    # of our own making: thousands of entries need no second look
    return Stitch.model_construct(
        method=method,
        image_matrices=tuple(images),
        cad_matrix=None if matrix is None else _fixed(matrix),
        row_motion=tuple(_fixed(rows)),
        status=status,
        reasons=reasons,
        quality=quality,
        surface=findings.surface,
        components=components,
    )


def _fixed(matrices: Floats) -> Floats:
    """A copy that cannot be changed."""
    out = matrices.copy()
    out.setflags(write=False)
    return out
