"""Conclude a run: compute its result from its evidence, stage by stage.

The order of the stages is that of section 3.3 of the paper. First the motion of the rows is estimated from links alone,
then the position of the board from its fiducials. Last, all unknowns are estimated together in one adjustment.

Measure the wall time of consecutive stages.

Build the result of a run from its findings.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import VISIBILITY, Reason, ReasonCode, Status, Stitch, Visibility
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, LinkStore, Problem
from vaoi_station.stitching.adjustment.row_motion import board_texture, motion_from_links, motion_from_marks
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping, MappingInputs, map_cad
from vaoi_station.stitching.board.reference import Reference, ReferenceScene
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.geometry import views_by_address
from vaoi_station.stitching.matching.evidence import METHODS, Detections, Evidence, FrameKey, Links, Method
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.matching.link import are_copies
from vaoi_station.stitching.matching.relinking import RowLinks, relink_rows
from vaoi_station.stitching.quality.confirmation import RowLights, dark_lights
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.quality_document import quality_document
from vaoi_station.stitching.quality.verdict import decide_verdict
from vaoi_station.version import __version__


@dataclass
class StageTimes:
    """Wall times of consecutive stages in ms, by name.

    The first stage begins when this object is created, every other stage when the stage before it ends.
    """

    ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def finish(self, name: str) -> None:
        """End the current stage and record its wall time under `name`."""
        now = time.perf_counter()
        self.ms[name] = round((now - self._last) * 1e3, 3)
        self._last = now


def build_result(
    findings: Findings, method: str, status: Status, reasons: tuple[Reason, ...], quality: dict[str, Any]
) -> Stitch:
    """Return the result document: matrices, surface, positions of components, and the verdict."""
    matrix = findings.cad_matrix
    # model_construct skips validation: the values are computed here, and a large board has thousands of entries
    return Stitch.model_construct(
        method=method,
        image_matrices=tuple(_image_matrices(findings)),
        camera_matrices=tuple(_read_only(c.image_from_row.matrix) for c in findings.scene.cameras),
        cad_matrix=None if matrix is None else _read_only(matrix),
        row_motion=tuple(_read_only(findings.adjusted.motion.rows_from_tester)),
        status=status,
        reasons=tuple(reason.text for reason in reasons),
        reason_codes=tuple(reason.code.value for reason in reasons),
        quality=quality,
        surface=findings.surface,
        components=_component_views(findings),
        local_matrices=_local_matrices(findings),
        board_matrices=_board_matrices(findings),
        skipped_boards=tuple(at for at, marks in findings.bad_marks.items() if marks.state == "bad") or None,
    )


def _image_matrices(findings: Findings) -> Iterator[tuple[NDArray[Any] | None, ...]]:
    """Yield for each camera i the matrices M_ij of all rows j; None for a frame that has no place on the board."""
    rows = findings.adjusted.motion.rows_from_tester
    for i, camera in enumerate(findings.scene.cameras):
        matrices = _read_only(camera.image_from_row.matrix @ rows)
        yield tuple(m if findings.places(i, j) else None for j, m in enumerate(matrices))


def _component_views(findings: Findings) -> dict[str, tuple[tuple[int, int, float, float], ...]] | None:
    """Return the footprint views (camera, row, x, y) of each component, by its address; None without a CAD mapping."""
    if findings.plane is None or findings.views is None:
        return None
    addresses = findings.plane.components.addresses
    return views_by_address(addresses, findings.views) if addresses else {}


def _local_matrices(findings: Findings) -> dict[str, Floats] | None:
    """Return C of the components that local fiducials place, by address; None without any."""
    places = findings.own_places.local.items()
    return {ref: _read_only(place.matrix) for ref, place in places if place.matrix is not None} or None


def _board_matrices(findings: Findings) -> dict[str, Floats] | None:
    """Return C of the boards of a panel that their fiducials place, by position; None without any."""
    return {position: _read_only(matrix) for position, matrix in findings.own_places.of_boards.items()} or None


def _read_only(matrices: Floats) -> Floats:
    """Return a read-only copy of matrices: results are used in several places."""
    out = matrices.copy()
    out.setflags(write=False)
    return out


NO_BOARD_TYPE = Failure("no board type was given, so there is no CAD mapping", ReasonCode.NO_BOARD_TYPE)


@dataclass(frozen=True, eq=False)
class PriorKnowledge:
    """Knowledge about a run from before its board is filmed: board plane, expectation, velocity, method, reference."""

    plane: BoardPlane | None
    """The board plane of the board type. None if no board type was given; the CAD matrix C is then not computed."""
    expectation: Expectation
    velocity_mm_s: Floats
    """(2,) nominal velocity of the conveyor."""
    method_name: str
    reference: Reference | None = None
    visibility: Visibility = VISIBILITY
    """How much of every component the frames must show, unless the board type states something else."""
    reference_frame: Callable[[FrameKey], PreparedFrame] | None = None
    """A function that returns a prepared frame of the reference; None if its frames cannot be read."""
    lights: tuple[str, ...] = ()
    """Name of the light of every row; empty if all rows have one."""
    channels: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """LED channels of every light, as far as they are known."""

    def taught(self, cameras: tuple[Camera, ...]) -> ReferenceScene | None:
        """Return the result and the frames of the reference, filmed by the same cameras.

        None if the method uses no reference, or if there is none, or if its frames cannot be read.
        """
        if self.reference is None or self.reference_frame is None or not self.method.reference:
            return None
        scene = Scene(cameras, tuple(sorted(self.reference.present)), self.reference_frame)
        return ReferenceScene(self.reference.stitch, scene)

    @property
    def method(self) -> Method:
        """The method named `method_name`: it states which kinds of evidence may be used."""
        return METHODS[self.method_name]


class SortedEvidence(NamedTuple):
    """The evidence of a run, separated by kind and sorted by task, so that the order of arrival has no influence."""

    links: tuple[Links, ...]
    reference_links: tuple[Links, ...]
    detections: tuple[Detections, ...]


def conclude(
    scene: Scene, prior: PriorKnowledge, times_s: Floats, evidence: Sequence[Evidence], link_store: LinkStore
) -> tuple[Stitch, Findings]:
    """Compute the result of a run from the evidence of its frames.

    Args:
        scene: the cameras and the good frames of the run.
        prior: what is known before the board is filmed.
        times_s: (m,) time of every row's pulse.
        evidence: the evidence of all canonical tasks (`work.all_tasks`), in any order.
        link_store: projects links to the ground. Links that were added to it before are not projected again.

    Returns:
        The result, and the findings from which the result and its verdict were derived.
    """
    stages = StageTimes()
    found = sort_evidence(evidence)
    copies = _copies(found.links) if prior.method.links else _compared_copies(scene)
    problem = _links_problem(prior, times_s, found, link_store)
    if prior.method.links:
        found, problem = _relinked(scene, prior, problem, found, link_store)
    motion = _estimate_motion(scene, prior, problem, found)
    stages.finish("motion")
    mapping = _map_cad(scene, prior, problem, motion, found)
    motion = _refine_motion(prior, problem, motion, mapping)
    corrected = _corrected_scene(scene, mapping)
    stages.finish("cad")
    findings = Findings(
        prior.plane,
        prior.expectation,
        corrected,
        prior.method,
        found.links,
        motion,
        scene.cameras,
        mapping,
        prior.visibility,
        prior.reference.sigma_px if prior.reference else 0.0,
        prior.taught(scene.cameras),
        copies=copies,
    )
    # Before rows are left out: a dark row has no links, so nothing but the belt's nominal speed places it.
    if prior.lights:
        lights = RowLights(prior.lights, prior.channels)
        findings = replace(findings, dark=dark_lights(findings.scene, lights, findings.checked.confirmed))
    findings = _without_unknown_rows(findings)
    status, reasons = decide_verdict(findings)
    quality = quality_document(findings) | _provenance(prior, stages)
    stages.finish("verdict")
    return build_result(findings, prior.method_name, status, reasons, quality), findings


def sort_evidence(evidence: Sequence[Evidence]) -> SortedEvidence:
    """Separate evidence by kind and sort each kind by task.

    Floating-point sums depend on the order of their terms. A fixed order makes the result reproducible.
    """
    order = sorted(evidence, key=lambda e: (e.task.a, e.task.b or (-1, -1), e.task.kind))
    return SortedEvidence(
        tuple(e for e in order if isinstance(e, Links) and e.task.kind != "reference"),
        tuple(e for e in order if isinstance(e, Links) and e.task.kind == "reference"),
        tuple(e for e in order if isinstance(e, Detections)),
    )


def _copies(links: Sequence[Links]) -> frozenset[FrameKey]:
    """Return the frames that the links between rows have found to equal the frame before in every pixel."""
    return frozenset(e.task.b for e in links if e.copied and e.task.b is not None)


def _compared_copies(scene: Scene) -> frozenset[FrameKey]:
    """Return the frames that equal the frame before in every pixel, for methods that link no rows."""
    pairs = [((camera, row - 1), (camera, row)) for camera, row in scene.present]
    there = set(scene.present)
    return frozenset(b for a, b in pairs if a in there and are_copies(scene.prepared(a).grey, scene.prepared(b).grey))


def _links_problem(prior: PriorKnowledge, times_s: Floats, found: SortedEvidence, link_store: LinkStore) -> Problem:
    """Return the adjustment problem of the row motion with links alone.

    All links count as links on the bare board (−1), because the components are not located before the CAD mapping.
    """
    links = link_store.observations(found.links)
    light = np.unique(prior.lights, return_inverse=True)[1] if prior.lights else np.zeros(len(times_s), np.int_)
    return Problem(times_s, prior.velocity_mm_s, links, np.full(len(links), -1), light=light)


def _relinked(
    scene: Scene, prior: PriorKnowledge, problem: Problem, found: SortedEvidence, link_store: LinkStore
) -> tuple[SortedEvidence, Problem]:
    """Search links again between rows between which the belt moved at another speed than its nominal one."""
    o = problem.links
    between = o.p != o.q
    measured = RowLinks(o.p[between], o.q[between], o.b_mm[between] - o.a_mm[between])
    links = relink_rows(found.links, measured, scene, prior.velocity_mm_s, problem.times_s)
    if all(new is old for new, old in zip(links, found.links, strict=False)) and len(links) == len(found.links):
        return found, problem
    found = found._replace(links=links)
    return found, _links_problem(prior, problem.times_s, found, link_store)


def _estimate_motion(scene: Scene, prior: PriorKnowledge, problem: Problem, found: SortedEvidence) -> AdjustmentResult:
    """Estimate the motion of the rows from links, or from detected marks if the method uses no links."""
    pivot = np.mean([c.row_from_image(c.center_px) for c in scene.cameras], axis=0)
    nominal = nominal_motion(problem.times_s, prior.velocity_mm_s, pivot)
    if prior.method.links:
        return motion_from_links(problem, nominal)
    return motion_from_marks(problem, nominal, found.detections, scene.cameras)


def _map_cad(
    scene: Scene, prior: PriorKnowledge, problem: Problem, motion: AdjustmentResult, found: SortedEvidence
) -> CadMapping | Failure:
    """Locate the board by its CAD data and adjust all unknowns together.

    Return a Failure if no board type was given or if the board is not found.
    """
    if prior.plane is None:
        return NO_BOARD_TYPE
    texture = board_texture(problem.links, motion) if prior.method.links else np.zeros((0, 2))
    inputs = MappingInputs(
        prior.expectation,
        prior.method,
        found.detections,
        texture,
        prior.reference,
        found.reference_links,
        prior.taught(scene.cameras),
    )
    return map_cad(prior.plane, scene, problem, motion, inputs)


def _refine_motion(
    prior: PriorKnowledge, problem: Problem, motion: AdjustmentResult, mapping: CadMapping | Failure
) -> AdjustmentResult:
    """Iterate the motion from links to full convergence, unless a CAD mapping has already adjusted it."""
    if isinstance(mapping, Failure):
        return adjust(problem, motion.motion) if prior.method.links else motion
    return mapping.moved or motion


def _without_unknown_rows(findings: Findings) -> Findings:
    """Return the findings without the rows in which the position of the board is not known.

    If the position is known in no row, the findings are returned without a CAD mapping.
    """
    if findings.unplaceable:
        return replace(
            findings,
            found=Failure(
                "the board is not placed: no links connect the rows that show its fiducials, so that the distance of "
                "the fiducials depends on the belt's nominal speed",
                ReasonCode.ROWS_NOT_CONNECTED,
            ),
        )
    if findings.far_off_plane and findings.mapping is not None:
        return replace(
            findings,
            found=Failure(
                "the board is not placed: its height by the overlaps is not that by the links, which were searched "
                "near the calibrated plane",
                ReasonCode.BOARD_OFF_PLANE,
            ),
        )
    rows = findings.unknown_rows
    if not rows:
        return findings
    scene = replace(findings.scene, present=tuple(key for key in findings.scene.present if key[1] not in rows))
    return replace(findings, scene=scene, unplaced=rows)


def _corrected_scene(scene: Scene, mapping: CadMapping | Failure) -> Scene:
    """Return the scene with the camera displacements that the adjustment of the CAD mapping estimated."""
    if isinstance(mapping, Failure) or mapping.adjusted.cameras is None:
        return scene
    return replace(scene, cameras=mapping.adjusted.problem.cameras)


def _provenance(prior: PriorKnowledge, stages: StageTimes) -> dict[str, Any]:
    """Return the entries of the quality document on software versions, reference, and wall times of the stages.

    `timings_ms` is the same object as `stages.ms`, not a copy: a stage that ends later still appears in it.
    """
    used = prior.reference is not None and prior.method.reference
    return {
        "timings_ms": stages.ms,
        "software": f"vaoi_station {__version__}",
        **({"reference": prior.reference.name} if prior.reference is not None and used else {}),
        "opencv": cv2.__version__,
    }
