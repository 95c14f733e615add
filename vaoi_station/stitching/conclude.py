"""Conclude a run: compute its result from its evidence, in the order of section 3.3 of the paper.

First the motion of the rows is estimated from links alone, then the position of the board from its fiducials. Last, all
unknowns are estimated together in one adjustment.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from operator import attrgetter
from typing import Any, NamedTuple

import cv2
import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode, Status, Stitch, Visibility
from vaoi_station.steps import Steps
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.adjustment.problem import LinkStore, Problem
from vaoi_station.stitching.adjustment.row_motion import MovedRows, board_texture, motion_from_links, motion_from_marks
from vaoi_station.stitching.adjustment.solver import Unknowns
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.cad_mapping import CadMapping, MappingInputs, map_cad, map_first_rows
from vaoi_station.stitching.board.reference import Reference, ReferenceScene
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import (
    METHODS,
    Detections,
    Evidence,
    FrameKey,
    Links,
    Method,
    MethodName,
    RowsLinks,
    by_rows,
)
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.matching.link import are_copies
from vaoi_station.stitching.matching.relinking import Relinker
from vaoi_station.stitching.quality.confirmation import dark_lights
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.quality_document import LATER, explanation, fiducial_places, quality_document
from vaoi_station.stitching.quality.verdict import judge_result
from vaoi_station.version import __version__

LEAST_BEGUN = 16_000
"""Least number of links with which the adjustment begins before the last row arrives. With fewer, all steps together
take less time than it costs to begin."""
NO_BOARD_TYPE = Failure("no board type was given, so there is no CAD mapping", ReasonCode.NO_BOARD_TYPE)
_NO_PLACE = Failure(
    "the board is not placed: no links connect the rows that show its fiducials, so that the distance of the fiducials "
    "depends on the belt's nominal speed",
    ReasonCode.ROWS_NOT_CONNECTED,
)
_OFF_PLANE = Failure(
    "the board is not placed: its height by the overlaps is not that by the links, which were searched near the "
    "calibrated plane",
    ReasonCode.BOARD_OFF_PLANE,
)


@dataclass(frozen=True, eq=False)
class PriorKnowledge:
    """Knowledge about a run from before its board is filmed; see `StitchSetup`."""

    plane: BoardPlane | None
    expectation: Expectation
    velocity_mm_s: Floats
    method_name: MethodName
    reference: Reference | None
    visibility: Visibility
    reference_frame: Callable[[FrameKey], PreparedFrame] | None
    """A function that returns a prepared frame of the reference; None if its frames cannot be read."""
    lights: tuple[str, ...]
    """Name of the light of every row; empty if all rows have one."""
    channels: Mapping[str, tuple[int, ...]]

    def taught(self, cameras: tuple[Camera, ...]) -> ReferenceScene | None:
        """Return the reference, filmed by these cameras; None if none is used or its frames cannot be read."""
        if self.reference is None or self.reference_frame is None or not self.method.reference:
            return None
        scene = Scene(cameras, tuple(sorted(self.reference.present)), self.reference_frame)
        return ReferenceScene(self.reference.stitch, scene)

    @property
    def method(self) -> Method:
        """The method named `method_name`: it states which kinds of evidence may be used."""
        return METHODS[self.method_name]


class SortedEvidence(NamedTuple):
    """The evidence of a run, separated by kind and sorted, so that the order of arrival has no influence."""

    of_rows: RowsLinks
    reference_links: tuple[Links, ...]
    detections: tuple[Detections, ...]

    @property
    def links(self) -> tuple[Links, ...]:
        """All links but those to a reference."""
        return tuple(chain.from_iterable(self.of_rows.values()))


def sort_evidence(evidence: Sequence[Evidence]) -> SortedEvidence:
    """Separate evidence by kind and sort each kind.

    Floating-point sums depend on the order of their terms. A fixed order makes the result reproducible.
    """
    links, others, detections = list[Links](), list[Links](), list[Detections]()
    for e in evidence:
        if isinstance(e, Detections):
            detections.append(e)
        else:
            (others if e.task.kind == "reference" else links).append(e)
    others.sort(key=attrgetter("task"))
    detections.sort(key=attrgetter("task"))
    return SortedEvidence(by_rows(links), tuple(others), tuple(detections))


class Beginning(NamedTuple):
    """The evidence of the first rows of a run; it equals another one if both are of the same evidence."""

    of_rows: RowsLinks
    detections: tuple[Detections, ...]
    times_s: tuple[float, ...]
    """Time of every row's pulse after the first, as the tasks of these links state it."""

    @staticmethod
    def of(of_rows: RowsLinks, detections: Iterable[Detections], rows: int) -> Beginning | None:
        """Put the evidence in order; None if a row was not linked to the one before, or the links are few."""
        times_s = [0.0]
        if sum(len(e.a_px) for links in of_rows.values() for e in links) < LEAST_BEGUN:
            return None
        for row in range(1, rows):
            if (row - 1, row) not in of_rows:
                return None
            times_s.append(times_s[-1] + of_rows[row - 1, row][0].task.dt_s)
        return Beginning(of_rows, tuple(sorted(detections, key=attrgetter("task"))), tuple(times_s))

    @property
    def present(self) -> tuple[FrameKey, ...]:
        """The frames of these rows: marks are searched in all of them."""
        return tuple(d.task.a for d in self.detections)


@dataclass(frozen=True, eq=False)
class Stitcher:
    """Computes the result of a run whose frames are all settled."""

    scene: Scene
    """The cameras and the good frames."""
    prior: PriorKnowledge
    times_s: Floats
    """(m,) time of every row's pulse."""
    link_store: LinkStore
    """Projects links to the ground. What it has of links that are complete is not computed again."""
    relinker: Relinker
    """Searches links again; what it has decided of rows whose links are complete is not decided again."""
    first_rows: Callable[[Beginning], Unknowns | None] | None = None
    """Returns the unknowns of all rows but the last one (`begin`), which may have been computed before the last row."""

    def stitch(self, evidence: Sequence[Evidence]) -> tuple[Stitch, Findings]:
        """Return the result before it is `explained`, and the findings from which it and its verdict were derived.

        `evidence` is that of all canonical tasks (`work.all_tasks`), in any order.
        """
        clock_s, sorted_evidence = [time.perf_counter()], sort_evidence(evidence)
        copies = self._copies(sorted_evidence.links)
        known, problem = self._relinked(sorted_evidence)
        motion = self._motion(problem, known)
        clock_s.append(time.perf_counter())
        beginning = self._beginning(known) if known.of_rows is sorted_evidence.of_rows else None
        mapping = self._map_cad(problem, motion, known, beginning)
        findings = self._findings(known, copies, motion, mapping)
        clock_s.append(time.perf_counter())
        if self.prior.lights:
            # Before rows are left out: a dark row has no links, so nothing but the belt's nominal speed places it.
            dark = dark_lights(findings.scene, self.prior.lights, self.prior.channels, findings.checked.confirmed)
            # Other findings would compute again what these have computed.
            findings = replace(findings, dark=dark) if dark else findings
        findings = without_unknown_rows(findings)
        status, reasons = judge_result(findings)
        quality = quality_document(findings)
        if findings.mapping is None:
            quality["fiducial_places"] = fiducial_places(known.detections, self.scene.cameras)
        clock_s.append(time.perf_counter())
        stages = zip(("motion", "cad", "verdict"), pairwise(clock_s), strict=True)
        quality["timings_ms"] = {name: round((end - start) * 1e3, 3) for name, (start, end) in stages}
        quality["software"] = f"vaoi_station {__version__}"
        if self.prior.reference is not None and self.prior.method.reference:
            quality["reference"] = self.prior.reference.name
        quality["opencv"] = cv2.__version__
        quality["later"] = list(LATER)
        return build_result(findings, self.prior.method_name, status, reasons, quality), findings

    def _copies(self, links: Sequence[Links]) -> frozenset[FrameKey]:
        """Return the frames that equal the frame before in every pixel; methods that link rows have compared them."""
        if self.prior.method.links:
            return frozenset(e.task.b for e in links if e.copied and e.task.b is not None)
        scene, there = self.scene, set(self.scene.present)
        pairs = [((camera, row - 1), (camera, row)) for camera, row in scene.present if (camera, row - 1) in there]
        return frozenset(b for a, b in pairs if are_copies(scene.prepared(a).grey, scene.prepared(b).grey))

    def _problem(self, links: RowsLinks) -> Problem:
        """Return the adjustment problem of the row motion with links alone.

        All links count as links on the bare board (−1), because the components are not located before the CAD mapping.
        """
        prior, observed = self.prior, self.link_store.observations(links.values())
        light = (
            np.unique(prior.lights, return_inverse=True)[1] if prior.lights else np.zeros(len(self.times_s), np.int_)
        )
        return Problem(self.times_s, prior.velocity_mm_s, observed, np.full(len(observed), -1), light=light)

    def _relinked(self, known: SortedEvidence) -> tuple[SortedEvidence, Problem]:
        """Search links again between rows between which the belt moved at another speed than its nominal one."""
        if self.prior.method.links:
            known = known._replace(of_rows=self.relinker.relinked(known.of_rows, self.scene.present, self.times_s))
        return known, self._problem(known.of_rows)

    def _motion(self, problem: Problem, known: SortedEvidence) -> MovedRows:
        """Estimate the motion of the rows from links, or from detected marks if the method uses no links."""
        cameras = self.scene.cameras
        pivot = np.mean([c.row_from_image(c.center_px) for c in cameras], axis=0)
        nominal = nominal_motion(self.times_s, self.prior.velocity_mm_s, pivot)
        if self.prior.method.links:
            parts = (self.link_store.part(own) for (p, q), own in known.of_rows.items() if p != q)
            return motion_from_links(problem, nominal, [part.step for part in parts if part.used])
        return motion_from_marks(problem, nominal, known.detections, cameras)

    def _beginning(self, known: SortedEvidence) -> Beginning | None:
        """Return the evidence of all rows but the last one; None if the run is not begun with it.

        Where frames of these rows are missing, it is known too late which ones.
        """
        last = len(self.times_s) - 1
        there = [key for key in self.scene.present if key[1] < last]
        if len(there) < last * len(self.scene.cameras):
            return None
        of_rows = {rows: links for rows, links in known.of_rows.items() if rows[1] < last}
        beginning = Beginning.of(of_rows, [d for d in known.detections if d.task.a[1] < last], last)
        return beginning if beginning is not None and beginning.present == tuple(there) else None

    def begin(self, beginning: Beginning) -> Steps[Unknowns | None]:
        """Adjust the unknowns of a run of which a row is still to come; None if the board is not found yet.

        That the motion was the nominal one, so that no links are searched again, is found out in the end.
        """
        if self.prior.plane is None:
            return None
        known = SortedEvidence(beginning.of_rows, (), beginning.detections)
        problem = self._problem(known.of_rows)
        yield
        motion = self._motion(problem, known)
        yield
        return (
            yield from map_first_rows(
                self.prior.plane, self.scene, problem, motion, self._inputs(problem, motion, known)
            )
        )

    def _inputs(self, problem: Problem, motion: MovedRows, known: SortedEvidence) -> MappingInputs:
        prior = self.prior
        texture = board_texture(problem.links, motion) if prior.method.links else np.zeros((0, 2))
        of_reference = prior.reference, known.reference_links, prior.taught(self.scene.cameras)
        return MappingInputs(prior.expectation, prior.method, known.detections, texture, *of_reference)

    def _map_cad(
        self, problem: Problem, motion: MovedRows, known: SortedEvidence, beginning: Beginning | None
    ) -> CadMapping | Failure:
        """Locate the board by its CAD data and adjust all unknowns together; fail without board type or board."""
        if self.prior.plane is None:
            return NO_BOARD_TYPE
        inputs = self._inputs(problem, motion, known)
        if beginning is not None and self.first_rows is not None:
            inputs = replace(inputs, first_rows=partial(self.first_rows, beginning))
        return map_cad(self.prior.plane, self.scene, problem, motion, inputs)

    def _findings(
        self, known: SortedEvidence, copies: frozenset[FrameKey], moved: MovedRows, mapping: CadMapping | Failure
    ) -> Findings:
        """Return the findings, with the camera displacements that the adjustment of the CAD mapping estimated."""
        prior, scene = self.prior, self.scene
        if isinstance(mapping, CadMapping):
            moved = mapping.moved or moved
        if isinstance(mapping, CadMapping) and mapping.adjusted.cameras is not None:
            scene = replace(scene, cameras=mapping.adjusted.problem.cameras)
        return Findings(
            prior.plane,
            prior.expectation,
            scene,
            prior.method,
            known.links,
            moved,
            self.scene.cameras,
            mapping,
            prior.visibility,
            prior.reference.sigma_px if prior.reference else 0.0,
            prior.taught(self.scene.cameras),
            copies=copies,
        )


def explained(result: Stitch, findings: Findings) -> Stitch:
    """Return a result with the entries of its `quality` that only explain its verdict, those that `later` names."""
    began_s = time.perf_counter()
    more = explanation(findings)
    spent = {"explanation": round((time.perf_counter() - began_s) * 1e3, 3)}
    known = {key: value for key, value in result.quality.items() if key != "later"}
    quality = {**known, **more, "timings_ms": {**result.quality["timings_ms"], **spent}}
    return result.model_copy(update={"quality": quality})


def without_unknown_rows(findings: Findings) -> Findings:
    """Return the findings without the rows in which the position of the board is not known.

    If the position is known in no row, the findings are returned without a CAD mapping.
    """
    if findings.unplaceable:
        return replace(findings, found=_NO_PLACE)
    if findings.far_off_plane and findings.mapping is not None:
        return replace(findings, found=_OFF_PLANE)
    rows = findings.unknown_rows
    if not rows:
        return findings
    scene = replace(findings.scene, present=tuple(key for key in findings.scene.present if key[1] not in rows))
    return replace(findings, scene=scene, unplaced=rows)


def build_result(
    f: Findings, method: str, status: Status, reasons: tuple[Reason, ...], quality: dict[str, Any]
) -> Stitch:
    """Return the result document: matrices, surface, positions of components, and the verdict."""
    rows, components = f.adjusted.motion.rows_from_tester, None
    if f.plane is not None and f.views is not None:
        addresses = f.plane.components.addresses
        components = f.views.by_address(addresses) if addresses else {}
    images = []
    for i, camera in enumerate(f.scene.cameras):
        matrices = _read_only(camera.image_from_row.matrix @ rows)
        images.append(tuple(m if f.places(i, j) else None for j, m in enumerate(matrices)))
    local = {ref: place.matrix for ref, place in f.own_places.local.items() if place.matrix is not None}
    # model_construct skips validation: the values are computed here, and a large board has thousands of entries
    return Stitch.model_construct(
        method=method,
        image_matrices=tuple(images),
        camera_matrices=tuple(_read_only(c.image_from_row.matrix) for c in f.scene.cameras),
        cad_matrix=None if f.cad_matrix is None else _read_only(f.cad_matrix),
        row_motion=tuple(_read_only(rows)),
        status=status,
        reasons=tuple(reason.message for reason in reasons),
        reason_codes=tuple(reason.code for reason in reasons),
        quality=quality,
        surface=f.surface,
        components=components,
        local_matrices={ref: _read_only(matrix) for ref, matrix in local.items()} or None,
        board_matrices={at: _read_only(matrix) for at, matrix in f.own_places.of_boards.items()} or None,
        skipped_boards=f.bad_boards or None,
    )


def _read_only(matrices: Floats) -> Floats:
    """Return a read-only copy of matrices: results are used in several places."""
    out = matrices.copy()
    out.setflags(write=False)
    return out
