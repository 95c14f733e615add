"""Components of a finished run: positions, views, and refusals that name what is missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.model import FrameRecord, RecordingHead, Status, Stitch, Verdict
from vaoi_station.rendering import ImageRequest, Measures, View
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
