"""A stitched run has the result of `vaoi stitch`, and keeps its evidence."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.reporting import StitchedRun
from vaoi_station.stitching.matching.evidence import Links
from vaoi_station.stitching.recordings.opening import open_run
from vaoi_station.stitching.recordings.origin import KEY
from vaoi_station.stitching.work import stitch_frames


def test_result_is_that_of_stitching(stitched: StitchedRun, run: Path) -> None:
    opened = open_run(run)
    alone = stitch_frames(opened.setup, opened.recording.head, opened.recording.frame).model_dump(mode="json")
    ours = stitched.result.model_dump(mode="json")
    for document in (alone, ours):
        del document["quality"]["timings_ms"]
    del ours["quality"][KEY]
    assert ours == alone


def test_every_frame_has_a_picture_and_every_kind_of_task_a_time(stitched: StitchedRun) -> None:
    assert set(stitched.thumbnails) == set(stitched.opened.present)
    assert set(stitched.task_ms) == {e.task.kind for e in stitched.evidence}
    assert all(ms > 0 for ms in stitched.task_ms.values())


def test_pairs_are_the_links_of_the_run(stitched: StitchedRun) -> None:
    asked = [e for e in stitched.evidence if isinstance(e, Links)]
    assert len(stitched.pairs) == len(asked)
    count = stitched.result.quality["links"]
    for kind in ("rows", "neighbours"):
        assert sum(p.used for p in stitched.pairs if p.links.task.kind == kind) == count[kind]["used"]
    for pair in stitched.pairs:
        assert (pair.residual_px is None) == (pair.used == 0)
        assert 0 <= pair.used <= len(pair.links.a_px)
