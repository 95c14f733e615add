"""Components of a finished run: where they were, and which frames show them."""

from __future__ import annotations

from collections import Counter

import numpy as np

from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.model import BoardType, Component, Verdict
from vaoi_station.rendering import View, ViewCalculator
from vaoi_station.runs.archive.finished_runs import Dossier
from vaoi_station.runs.states.schemas import ComponentSummary


def components_of(dossier: Dossier) -> tuple[ComponentSummary, ...]:
    """All components of the board type the run was filmed with; places where there is a CAD mapping."""
    board_type, stitch = dossier.board_type, dossier.without_components
    from_cad = stitch.tester_from_cad if stitch else None
    seen = _times_seen(dossier)
    parts = board_type.components
    places = from_cad(np.array([c.center for c in parts])) if from_cad and parts else [None] * len(parts)
    return tuple(
        _summary(part, board_type.mm_per_unit, None if at is None else (float(at[0]), float(at[1])), seen[part.address])
        for part, at in zip(parts, places, strict=True)
    )


def views_of_component(dossier: Dossier, ref: str, px_per_mm: float | None, min_coverage: float) -> tuple[View, ...]:
    """The good frames that show a component, best first; `NotFoundError` without such a component."""
    part = component_of(dossier.board_type, ref)
    whole = {(f.camera, f.row) for f in dossier.detail.frames if f.verdict is Verdict.OK}
    views = dossier.view_calculator.compute(part, px_per_mm=px_per_mm, min_coverage=min_coverage)
    return tuple(view for view in views if (view.camera, view.row) in whole)


def view_of_component(dossier: Dossier, ref: str, k: int, px_per_mm: float | None, min_coverage: float) -> View:
    """View k; `NotFoundError` says how many there are."""
    views = views_of_component(dossier, ref, px_per_mm, min_coverage)
    if not 0 <= k < len(views):
        raise NotFoundError(
            f"Component {ref!r} of run {dossier.detail.id} has {len(views)} images, numbered from 0; there is no {k}.",
            action="Ask for one of the component's list, or for a lower min_coverage.",
            code="no-such-image",
        )
    return views[k]


def component_of(board_type: BoardType, ref: str) -> Component:
    """The component of an address; `NotFoundError` names the board type."""
    part = board_type.component(ref)
    if part is None:
        raise NotFoundError(
            f"Board type {board_type.name!r} has no component {ref!r} ({len(board_type.components)} others).",
            action="See the run's list of components; on a panel the address is panel/ref.",
            code="unknown-component",
        )
    return part


def refuse_holes(verdict: Verdict, cause: str, where: str, allow_incomplete: bool) -> None:
    """Pixels that are not a whole frame are served only to who asks for them."""
    if verdict is Verdict.MISSING:
        raise NotFoundError(f"{where} never arrived: {cause}.", code="frame-missing")
    if verdict is Verdict.INCOMPLETE and not allow_incomplete:
        raise StateError(
            f"{where} is incomplete: {cause}. Its holes are black.",
            action="Allow incomplete frames to see what there is.",
            code="frame-incomplete",
        )


def _times_seen(dossier: Dossier) -> Counter[str]:
    """How many pictures of each component the run offers by default: good frames that show at least half of it."""
    stitch = dossier.without_components
    if stitch is None or stitch.cad_matrix is None:
        return Counter()
    whole = {(f.camera, f.row) for f in dossier.detail.frames if f.verdict is Verdict.OK}
    board = ViewCalculator(dossier.board_type, stitch, dossier.cameras).compute_all(dossier.board_type.components)
    return Counter({address: sum((v.camera, v.row) in whole for v in views) for address, views in board.items()})


def _summary(part: Component, mm: float, tester_mm: tuple[float, float] | None, views: int) -> ComponentSummary:
    return ComponentSummary(
        address=part.address,
        ref=part.ref,
        panel=part.panel,
        center_mm=(part.center[0] * mm, part.center[1] * mm),
        width_mm=part.width * mm,
        height_mm=part.height * mm,
        rotation_deg=part.rotation,
        tester_mm=tester_mm,
        views=views,
    )
