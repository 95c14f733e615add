"""Components of a finished run: their positions, and the frames that show them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np

from vaoi_station.clamping import FilmedBoard
from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.files.results import component_tables
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Component, FrameRecord, Status, Verdict
from vaoi_station.model.stitch_result import Heights, with_heights
from vaoi_station.rendering import (
    ChosenImages,
    ChosenView,
    Framing,
    ImageRequest,
    View,
    choose_all,
)
from vaoi_station.rendering.selection import Measure, select
from vaoi_station.rendering.views import ViewTable
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.states.schemas import ComponentSummary
from vaoi_station.stitching.geometry import ComponentIndex

_ALIKE = 8
"""Largest number of addresses that the refusal of an unknown component names."""
_RUNS = 4
"""Number of runs whose tables are kept between requests: callers read the pictures of few runs at a time."""
_GROUP, _GROUPS = 64, 512
"""Number of components whose views are computed at once, and of such groups that are kept of a run."""
_ALONE, _KINDS = 8, 16
"""Number of requests of one kind, to one run, after which views are computed in groups, and of kinds that are counted.

64 components take five times as long as one: callers that read few get each one alone."""


def components_of(finished: FinishedRun) -> tuple[ComponentSummary, ...]:
    """Return a summary of every component of the run's board type. Without a CAD mapping, positions are None."""
    board_type, stitch, mm = finished.board_type, finished.stitch, finished.board_type.mm_per_unit
    usable, index = finished.usable_frames, ComponentIndex.of(board_type)
    views, seen = Counter[str](), None
    if stitch is not None and stitch.cad_matrix is not None:
        # Frames that show at least half of each component, and how much of it all of them show.
        views.update(finished.view_calculator.compute_all(board_type.components).counts_in(usable))
        moved = index.moved(stitch.displacements(index.addresses))
        rows, cad = np.array(stitch.row_motion), np.asarray(stitch.cad_matrix)
        seen = FrameIndex(finished.cameras, rows, list(usable), stitch.surface, cad).coverage(moved.corners)
    unseen, skipped = {u.address for u in finished.detail.unseen}, finished.detail.skipped_boards
    sigmas_px = tables_of(finished).get("component_sigma_px", {}) if finished.document else {}
    footprints = index.corners.round(6).tolist()
    px_per_mm = float(np.mean([c.px_per_mm for c in finished.cameras])) if finished.cameras else np.inf
    found = []
    for n, part in enumerate(board_type.components):
        matrix = None if stitch is None else stitch.component_matrix(part.address)
        sigma_px = sigmas_px.get(part.address)
        summary = ComponentSummary(
            address=part.address,
            ref=part.ref,
            panel=part.panel,
            center_mm=(part.center[0] * mm, part.center[1] * mm),
            width_mm=part.width * mm,
            height_mm=part.height * mm,
            rotation_deg=part.rotation,
            tester_mm=None if matrix is None else tuple(apply(matrix, np.array(part.center)).tolist()),
            views=views[part.address],
            coverage=None if seen is None else round(float(seen.share[n]), 4),
            in_one_frame=None if seen is None else bool(seen.in_one_frame[n]),
            unseen=part.address in unseen,
            skipped=part.panel is not None and str(part.panel) in skipped,
            sigma_px=sigma_px,
            sigma_mm=None if sigma_px is None else round(sigma_px / px_per_mm, 6),
            footprint=tuple(map(tuple, footprints[n])),
        )
        found.append(summary)
    return tuple(found)


def images_of_component(
    finished: FinishedRun, ref: str, wanted: ImageRequest, measure: Measure, heights_mm: Heights | None = None
) -> ChosenImages:
    """Choose the images of a component in usable frames.

    Args:
        finished: the run.
        ref: address of the component.
        wanted: the request.
        measure: function that measures a view; it is called only if the request needs it.
        heights_mm: heights that replace those of the result, which follow from few links.

    Raises:
        NotFoundError: the component is unknown.
        InputError: an image would be too large, or the run has no frame under a light that the request names.
        StateError: the request names a direction, and the calibration does not give directions.
    """
    parts = finished.board_type.components
    number = _numbers(finished).get(ref)
    # The complete result is parsed only for a request that needs the height of a body.
    on_top = wanted.framing.plane == "top"
    if number is not None and not on_top and (views := _kept_views(finished)).is_frequent(wanted.check()):
        # One that is refused does not prevent its neighbours; it is refused again below.
        with suppress(InputError, StateError):
            found = views.of(number, wanted)
            usable = [view for view in found if (view.camera, view.row) in finished.usable_frames]
            chosen = select(usable, finished.frame_facts, wanted, measure)
            return ChosenImages(parts[number], chosen, None, None)
    part = component_of(finished.board_type, ref) if number is None else parts[number]
    calculator = finished.view_calculator
    stitch = with_heights(finished.result, heights_mm or {}) if on_top else finished.lean
    frames = finished.usable_frames, finished.frame_facts
    return choose_all(calculator, [part], (finished.board_type, stitch), frames, wanted.check(), measure)[0]


def image_of_component(
    finished: FinishedRun,
    ref: str,
    k: int,
    wanted: ImageRequest,
    measure: Measure,
    heights_mm: Heights | None = None,
) -> ChosenView:
    """Return image k of a component. Raise NotFoundError, with the number of images, if there is no image k."""
    chosen = images_of_component(finished, ref, wanted.unmeasured(), measure, heights_mm).chosen
    if not 0 <= k < len(chosen):
        raise NotFoundError(
            f"Component {ref!r} of run {finished.detail.id} has {len(chosen)} images, "
            f"numbered from 0; there is no {k}.",
            action="Request an image of the component's list, or ask for less: lower min_coverage, other bounds.",
            code="no-such-image",
        )
    return chosen[k]


@lru_cache(_RUNS)
def _numbers(finished: FinishedRun) -> Mapping[str, int]:
    """Return the numbers of the components of the run's board type by address."""
    return {part.address: n for n, part in enumerate(finished.board_type.components)}


class _KeptViews:
    """The views of a run's components in the plane of the board, computed in groups when callers read many."""

    def __init__(self, finished: FinishedRun) -> None:
        self._calculator, self._parts = finished.view_calculator, finished.board_type.components
        self._requests = lru_cache(_KINDS)(lambda *_: itertools.count())
        self._group = lru_cache(_GROUPS)(self._computed)

    def is_frequent(self, wanted: ImageRequest) -> bool:
        """Note a request, and return whether there were several of its kind: with this framing and least coverage."""
        return next(self._requests(wanted.framing, wanted.bounds.min_coverage)) >= _ALONE

    def of(self, number: int, wanted: ImageRequest) -> tuple[View, ...]:
        """Return the views of the component with a number, best first."""
        group, place = divmod(number, _GROUP)
        return self._group(wanted.framing, wanted.bounds.min_coverage, group).views_of(place)

    def _computed(self, framing: Framing, min_coverage: float, group: int) -> ViewTable:
        parts = self._parts[group * _GROUP : (group + 1) * _GROUP]
        return self._calculator.compute_all(parts, min_coverage=min_coverage, framing=framing)


@lru_cache(_RUNS)
def _kept_views(finished: FinishedRun) -> _KeptViews:
    return _KeptViews(finished)


@lru_cache(_RUNS)
def tables_of(finished: FinishedRun) -> Mapping[str, Mapping[str, Any]]:
    """Return the tables of components of a run's result. Raise `NotFoundError` if the run ended without a result.

    To read them from the text takes more than ten milliseconds for a large board, so that they are kept.
    """
    return component_tables(finished.text)


def filmed_board(finished: FinishedRun, heights_mm: Heights | None) -> FilmedBoard:
    """Return what a run knows of its board, for a tester that has clamped it; raises the errors of `FilmedBoard`.

    `heights_mm` are the heights measured from all frames; None: those that follow from links.
    """
    tables = tables_of(finished)
    by_links = tables.get("heights_mm", {}), tables.get("height_sigma_mm", {})
    known = {ref: (mm, by_links[1][ref]) for ref, mm in by_links[0].items() if ref in by_links[1]}
    px_per_mm = float(np.mean([c.px_per_mm for c in finished.cameras]))
    reasons, verdict = tuple(r.message for r in finished.detail.reasons), finished.detail.verdict
    result = with_heights(finished.lean, {**known, **(heights_mm or {})})
    return FilmedBoard(finished.board_type, result, px_per_mm, verdict or Status.FAILED, reasons)


def component_of(board_type: BoardType, ref: str) -> Component:
    """Return the component with the address `ref`. Raise NotFoundError if the board type does not have it."""
    part = board_type.component(ref)
    if part is None:
        others = board_type.components
        meant = [c.address for c in others if c.ref.casefold() == ref.rpartition("/")[2].casefold()][:_ALIKE]
        raise NotFoundError(
            f"Board type {board_type.name!r} has no component {ref!r} ({len(others)} others).",
            action=f"It has {', '.join(meant)}; see the run's list of components."
            if meant
            else "See the run's list of components; on a panel the address is panel/ref.",
            code="unknown-component",
        )
    return part


def refuse_unusable(frame: FrameRecord, where: str, allow_incomplete: bool) -> None:
    """Raise NotFoundError if a frame is missing, StateError if it is not usable and such frames are not allowed.

    `where` names the frame in the message. Frames that are not proven to belong to their row count as incomplete.
    """
    if frame.verdict is Verdict.MISSING:
        raise NotFoundError(f"{where} never arrived: {frame.cause}.", code="frame-missing")
    if frame.usable or allow_incomplete:
        return
    if frame.verdict is Verdict.INCOMPLETE:
        raise StateError(
            f"{where} is incomplete: {frame.cause}. Its holes are black.",
            action="Allow incomplete frames to get it.",
            code="frame-incomplete",
        )
    raise StateError(
        f"{where} may show another row: {frame.cause}.",
        action="Do not apply the matrix of its row to it. Allow incomplete frames to get it.",
        code="frame-unproven",
    )
