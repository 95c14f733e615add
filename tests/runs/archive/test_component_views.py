"""Components of a finished run: positions, views, and refusals that name what is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.model import BoardType, Component, FrameRecord, RecordingHead, Status, Stitch, Verdict
from vaoi_station.rendering import ImageRequest, Measures, View, ViewCalculator
from vaoi_station.runs.archive import component_views
from vaoi_station.runs.archive.finished_runs import FinishedRun


def finished_run(rig: Any, verdicts: dict[int, Verdict] | None = None) -> FinishedRun:
    grant = rig.arm()
    rig.board(grant, verdicts=verdicts)
    rig.result_of(grant.run)
    finished: FinishedRun = rig.archive.get(grant.run)
    return finished


def unmeasured(_: View) -> Measures | None:
    return None


def views_of(finished: FinishedRun, **options: Any) -> list[View]:
    wanted = ImageRequest.of(options)  # type: ignore[arg-type]  # keywords of a test
    return [s.view for s in component_views.images_of_component(finished, "U1", wanted, unmeasured).chosen]


def test_positions_are_those_of_the_cad_mapping_and_views_are_counted(rig: Any) -> None:
    finished = finished_run(rig)
    [component] = component_views.components_of(finished)
    assert (component.address, component.center_mm, component.tester_mm) == ("U1", (10, 10), (10.0, 20.0))
    assert component.views == len(views_of(finished)) > 0
    assert component.footprint == ((8, 8), (12, 8), (12, 12), (8, 12))


def test_unseen_components_are_named_by_run_event_and_list(rig: Any, make_stitch: Callable[..., Stitch]) -> None:
    figures = {"coverage": 0.4, "views": 0, "in_one_frame": False, "cause": "frames-lost"}

    def partly(head: RecordingHead) -> Stitch:
        found = make_stitch(head, Status.DEGRADED, ("the good frames show too little of 1 of 1 components (U1)",))
        return found.model_copy(update={"quality": found.quality | {"unseen": {"U1": figures}}})

    rig.workers.result = partly
    finished = finished_run(rig)
    assert [u.model_dump() for u in finished.detail.unseen] == [{"address": "U1", **figures}]
    [component] = component_views.components_of(finished)
    assert component.unseen
    assert component.coverage is not None
    event = next(e for e in rig.coordinator.events(0, 0.0) if e.run == finished.detail.id and e.state == "degraded")
    assert "(U1)" in event.message


def test_callers_of_many_components_get_what_each_one_gets_alone(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is refused, because its picture would be too large, prevents none of its neighbours."""
    finished = finished_run(rig)
    sizes = {f"R{n}": 0.5 + 0.1 * n for n in range(80)} | {"R5": 900.0}
    parts = [{"ref": ref, "center": (10, 10), "width": mm, "height": mm} for ref, mm in sizes.items()]
    board_type = BoardType.model_validate({**finished.board_type.model_dump(), "components": parts})
    finished = replace(finished, board_type=board_type)
    alone = {part.ref: finished.view_calculator.compute(part) for part in board_type.components}
    calls, compute_all = list[int](), ViewCalculator.compute_all

    def counted(calculator: ViewCalculator, parts: Sequence[Component], **options: Any) -> Any:
        calls.append(len(parts))
        return compute_all(calculator, parts, **options)

    monkeypatch.setattr(ViewCalculator, "compute_all", counted)
    # In no order of the board type, as a caller that requests suspicious components first.
    for ref in sorted(sizes, key=lambda ref: ref[::-1]):
        found = [c.view for c in component_views.images_of_component(finished, ref, ImageRequest(), unmeasured).chosen]
        assert [(v.camera, v.row) for v in found] == [(v.camera, v.row) for v in alone[ref]]
        assert np.array_equal([v.matrix for v in found], [v.matrix for v in alone[ref]])
        assert [(v.width, v.height, v.coverage) for v in found] == [(v.width, v.height, v.coverage) for v in alone[ref]]
    assert calls == [1] * 8 + [64, 16], "each of the first ones alone, then groups"
    fine = ImageRequest.of({"px_per_mm": 40})
    for ref in sizes:
        if ref == "R5":
            with pytest.raises(InputError):
                component_views.images_of_component(finished, ref, fine, unmeasured)
        else:
            assert component_views.images_of_component(finished, ref, fine, unmeasured).chosen


@pytest.mark.parametrize(
    ("verdict", "proven", "allowed", "error"),
    [
        (Verdict.OK, False, True, None),
        (Verdict.OK, False, False, StateError),
        (Verdict.INCOMPLETE, True, False, StateError),
        (Verdict.MISSING, True, True, NotFoundError),
    ],
)
def test_only_usable_frames_or_allowed_ones_are_served(
    verdict: Verdict, proven: bool, allowed: bool, error: type[Exception] | None
) -> None:
    frame = FrameRecord(camera=0, row=1, verdict=verdict, cause="cable", proven=proven)
    if error is None:
        component_views.refuse_unusable(frame, "Frame (0, 1)", allowed)
    else:
        with pytest.raises(error, match=r"Frame \(0, 1\).*: cable\."):
            component_views.refuse_unusable(frame, "Frame (0, 1)", allowed)
