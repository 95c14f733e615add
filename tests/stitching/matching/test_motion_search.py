"""The motion between two rows in the whole range of a belt, from textures that are formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.hostile.drawing import Drawing, changed
from tests.hostile.filming import film
from tests.hostile.judging import Outcome, compare, stitched
from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.simulation import read_scenario, scenario_path
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.relinking import candidate_motions, has_rival, possible_motions

NOMINAL = np.array([0.0, 10.0])
NOMINAL_GRID = np.array([0.0, 11.0])


def pair_of(workshop: Any, motion: tuple[float, float], seed: int = 0) -> FramePair:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    texture = workshop.waves(seed=seed, finest=0.8, coarsest=6.0)
    a, b = (
        PreparedFrame(texture.seen_by(camera, lambda at, by=by: at - np.asarray(by))) for by in ((0.0, 0.0), motion)
    )
    return FramePair(a, b, camera, camera, NOMINAL)


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.3, 4.0), (0.0, 10.0), (-0.4, 14.5)])
def test_a_motion_from_none_to_one_and_a_half_is_found(workshop: Any, motion: tuple[float, float]) -> None:
    pairs = [pair_of(workshop, motion, seed) for seed in (1, 2)]
    assert np.hypot(*(candidate_motions(pairs)[0] - motion)) < 0.5


def test_unrelated_and_empty_frames_have_no_motion_in_common(workshop: Any) -> None:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    empty = PreparedFrame(np.full((240, 320), 20, np.uint8))
    assert candidate_motions([FramePair(empty, empty, camera, camera, NOMINAL)]) == []
    assert candidate_motions([]) == []


def verdict_on(board: dict[str, Any], **more: dict[str, Any]) -> tuple[Outcome, tuple[str, ...]]:
    """Film a board of the small scenario with changes, and stitch it; return errors and codes of reasons."""
    scenario = changed(read_scenario(scenario_path("small")), {"board": board, **more})
    filmed, outcome = film(Drawing(0, scenario, ())), Outcome(0)
    stitch, findings = stitched(filmed)
    compare(outcome, filmed, stitch, findings)
    assert bool(stitch.quality["rows_apart"]) == ("rows-repetitive" in (stitch.reason_codes or ()))
    return outcome, tuple(stitch.reason_codes or ())


@pytest.mark.parametrize("pitch_mm", [2.5, 3.0])
def test_cameras_agree_on_one_motion_of_a_grid(pitch_mm: float) -> None:
    """One of the cameras alone takes a motion that is wrong by a spacing, 45 and 54 px."""
    outcome, codes = verdict_on({"grid_mm": pitch_mm})
    assert (outcome.status, codes) == ("ok", ())
    assert outcome.rms_px < 0.1


def test_rows_without_a_mark_are_named() -> None:
    marks = [{"x_mm": x, "y_mm": 36.0, "diameter_mm": 1.0} for x in (4.0, 40.0, 56.0)]
    outcome, codes = verdict_on({"grid_mm": 2.5, "fiducials": marks, "length_mm": 40.0})
    assert (outcome.status, codes) == ("degraded", ("rows-repetitive",))
    assert outcome.rms_px < 0.1


def links_of(b_mm: float, rival_mm: float | None) -> Links:
    """Return links of 10 px/mm that measure a motion, in a frame where another one fits as well."""
    a = np.array([[100.0, 50.0], [200.0, 60.0], [300.0, 70.0]])
    rival = None if rival_mm is None else (0.0, (rival_mm - 11.0) * 10)
    task = Task("rows", (0, 0), (0, 1), 0.11)
    none = np.zeros((3, 2, 2)), np.ones(3)
    return Links(task, a, a + (0.0, 10 * b_mm), *none, coarse_px=(0.0, (b_mm - 11.0) * 10), rival_px=rival)


@pytest.mark.parametrize(
    ("links", "motions"),
    [
        ([links_of(11.0, None)], [11.0]),
        ([links_of(11.0, 13.0)], [11.0, 13.0, 9.0]),
        ([links_of(9.0, None), links_of(11.1, None), links_of(11.2, None)], [9.0, 11.1]),
        ([links_of(13.0, 11.0)], [13.0, 11.0]),
        ([Links.empty(Task("rows", (0, 0), (0, 1)), "none")], []),
    ],
)
def test_motions_within_reach_that_a_camera_allows(links: list[Links], motions: list[float]) -> None:
    n = Projective(np.diag([10.0, 10.0, 1.0]), System.IMAGE, System.ROW)
    camera = Camera(640, 480, n, Lens((0.0, 0.0), 1.0))
    found = possible_motions(links, [camera], NOMINAL_GRID)
    assert [round(float(y), 3) for _, y in found] == motions
    assert has_rival(links) == any(e.rival_px is not None for e in links)


def test_texture_that_stands_still_does_not_hide_what_moves(workshop: Any) -> None:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    bed = workshop.waves(seed=5, finest=0.8, coarsest=6.0).seen_by(camera, lambda at: at)
    board = workshop.waves(seed=9, finest=0.8, coarsest=6.0)
    frames = []
    for by in (0.0, 9.0):
        frame = bed.copy()
        frame[:, 240:] = board.seen_by(camera, lambda at, by=by: at - np.array([0.0, by]))[:, 240:]
        frames.append(PreparedFrame(frame))
    pair = FramePair(frames[0], frames[1], camera, camera, NOMINAL)
    assert np.hypot(*candidate_motions([pair])[0]) < 0.5
    assert np.hypot(*(candidate_motions([pair], moving=True)[0] - (0.0, 9.0))) < 0.5
