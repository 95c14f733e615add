"""Boards on belts that stop, slow down or hurry: found from the pictures, or not placed and said so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.hostile.drawing import Drawing, changed
from tests.hostile.filming import film
from tests.hostile.judging import Outcome, compare
from tests.hostile.judging import stitched as stitched_film
from vaoi_station.model import Status
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.scenario import Scenario, SpeedChange
from vaoi_station.steps import completed
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.matching.relinking import (
    Relinker,
    candidate_motions,
)
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

NOMINAL = np.array([0.0, 10.0])


def verdict_on(board: dict[str, Any], **more: dict[str, Any]) -> tuple[Outcome, tuple[str, ...]]:
    """Film a board of the small scenario with changes, and stitch it; return errors and codes of reasons."""
    scenario = changed(read_scenario(scenario_path("small")), {"board": board, **more})
    filmed, outcome = film(Drawing(0, scenario, ())), Outcome(0)
    stitch, findings = stitched_film(filmed)
    compare(outcome, filmed, stitch, findings)
    assert bool(stitch.quality["rows_apart"]) == ("rows-repetitive" in (stitch.reason_codes or ()))
    return outcome, tuple(stitch.reason_codes or ())


@pytest.mark.parametrize("pitch_mm", [2.5, 3.0])
def test_cameras_agree_on_one_motion_of_a_grid(pitch_mm: float) -> None:
    """One of the cameras alone takes a motion that is wrong by a spacing, 45 and 54 px."""
    outcome, codes = verdict_on({"grid_mm": pitch_mm})
    assert (outcome.status, codes) == ("ok", ())
    assert outcome.rms_px < 0.1


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
    assert np.hypot(*completed(candidate_motions([pair]))[0]) < 0.5
    assert np.hypot(*(completed(candidate_motions([pair], moving=True))[0] - (0.0, 9.0))) < 0.5


def filmed_on(belt: dict[str, Any], **array: Any) -> tuple[Any, Any, Any]:
    """Film the small board on another belt; return recording head, setup and passage."""
    known: Scenario = read_scenario(scenario_path("small"))
    line = known.line.model_copy(update={"longest_board_mm": 150.0, "tail_s": 1.3})
    scenario = known.model_copy(
        update={
            "belt": known.belt.model_copy(update=belt),
            "line": line,
            "array": known.array.model_copy(update=array),
        }
    )
    twin = Twin(scenario)
    passage = twin.passage(0)
    head = passage.head()
    setup = StitchSetup(
        twin.calibration.cameras(head.cameras), head.conveyor_mm_s, head.trigger_period_s, twin.board_type
    )
    return head, setup, passage


def stitched(head: Any, setup: StitchSetup, frames: dict[tuple[int, int], Any]) -> Any:
    runner = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    times = head.row_times_s()
    tasks = all_tasks(frames, dict(enumerate(times)), setup)
    return runner.conclude(times, tuple(frames), [runner.perform(task) for task in tasks])


def worst_px(result: Any, truth: Any) -> float:
    ours = {(ref, i, j): (x, y) for ref, views in result.components.items() for i, j, x, y in views}
    off = [
        np.hypot(ours[ref, i, j][0] - x, ours[ref, i, j][1] - y)
        for ref, views in truth["views"].items()
        for i, j, x, y in views
        if result.image_matrices[i][j] is not None
    ]
    return float(max(off))


BELTS: dict[str, dict[str, Any]] = {
    "stop": {"changes": (SpeedChange(at_s=0.62, for_s=0.4, factor=0.0),)},
    "slow": {"speed_error": -0.4},
    "slow for a while": {"changes": (SpeedChange(at_s=0.6, for_s=0.5, factor=0.45),)},
}


@pytest.mark.parametrize("belt", BELTS.values(), ids=BELTS)
def test_a_belt_that_stops_or_slows_down_is_followed(belt: dict[str, Any]) -> None:
    head, setup, passage = filmed_on(belt)
    result = stitched(head, setup, passage.render_all())
    assert result.status == Status.OK, result.reasons
    assert worst_px(result, passage.truth()) < 0.15


def test_static_structure_in_the_scene_is_no_stop(workshop: Any) -> None:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    dirt = workshop.waves(seed=5, finest=0.8, coarsest=6.0).seen_by(camera, lambda at: at)
    noise = np.random.default_rng(3)
    frames = [workshop.digitised(dirt + noise.normal(0, 2, dirt.shape)) for _ in range(4)]
    board = workshop.waves(seed=9, finest=0.8, coarsest=6.0)
    # the board moves by 3 mm from row to row in the lower half of the frames, far less than the nominal 10 mm
    for j, frame in enumerate(frames):
        frame[100:] = board.seen_by(camera, lambda at, j=j: at - np.array([0.0, 3.0 * j]))[100:]
    prepared = {(0, j): PreparedFrame(frame) for j, frame in enumerate(frames)}
    scene = Scene((camera,), tuple(sorted(prepared)), prepared.__getitem__)
    relinker = Relinker((camera,), np.array([0.0, 100.0]), scene.prepared, lambda links: pytest.fail("there are none"))
    found = relinker.relinked({}, scene.present, np.array([0.0, 0.1, 0.2, 0.3]))
    links = [e for own in found.values() for e in own]
    moved = {e.task.b[1]: np.median((camera.ground(e.b_px) - camera.ground(e.a_px))[:, 1]) for e in links if e.task.b}
    assert moved == pytest.approx({1: 3.0, 2: 3.0, 3: 3.0}, abs=0.05)


@pytest.mark.parametrize("rows", [(0, 1), (1, 2), (2, 3)])
def test_a_bed_with_more_texture_than_the_board_is_no_stop(workshop: Any, rows: tuple[int, int]) -> None:
    """The board covers the bed in the rows beside these, so that nothing else shows that the bed is static."""
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    bed = workshop.waves(seed=5, finest=0.8, coarsest=6.0).seen_by(camera, lambda at: at)
    board, noise = workshop.waves(seed=9, finest=0.8, coarsest=6.0), np.random.default_rng(3)
    frames = []
    for j in range(4):
        seen = board.seen_by(camera, lambda at, j=j: at - np.array([0.0, 9.0 * j]))
        frame = seen if j not in rows else np.where(np.arange(320) >= 230, seen, bed)
        frames.append(PreparedFrame(workshop.digitised(frame + noise.normal(0, 1, frame.shape))))
    scene = Scene((camera,), tuple((0, j) for j in range(4)), lambda key: frames[key[1]])
    relinker = Relinker((camera,), np.array([0.0, 100.0]), scene.prepared, lambda links: pytest.fail("there are none"))
    found = relinker.relinked({}, scene.present, np.array([0.0, 0.1, 0.2, 0.3]))
    links = [e for own in found.values() for e in own]
    moved = {e.task.b[1]: np.median((camera.ground(e.b_px) - camera.ground(e.a_px))[:, 1]) for e in links if e.task.b}
    assert moved[rows[1]] == pytest.approx(9.0, abs=0.05)


def test_links_at_the_nominal_motion_stay_as_they_are(filmed: Any) -> None:
    runner = TaskRunner(filmed.setup, filmed.frame)
    tasks = all_tasks(filmed.present, dict(enumerate(filmed.times_s)), filmed.setup)
    evidence = [runner.perform(task) for task in tasks]
    _, findings = runner.conclude_with_findings(filmed.times_s, filmed.present, evidence)
    found = {e.task: e for e in evidence if isinstance(e, Links)}
    assert all(e is found[e.task] for e in findings.links)


@pytest.mark.parametrize("belt", BELTS.values(), ids=BELTS)
def test_what_is_decided_while_the_board_passes_is_the_same_as_at_its_end(belt: dict[str, Any]) -> None:
    """The evidence arrives in any order, and the preparation stops anywhere."""
    head, setup, passage = filmed_on(belt)
    frames, times, g = passage.render_all(), head.row_times_s(), np.random.default_rng(3)
    late = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    evidence = [late.perform(task) for task in all_tasks(frames, dict(enumerate(times)), setup)]
    at_end = late.conclude(times, tuple(frames), evidence)
    for steps in (12, 10_000):
        early = TaskRunner(setup, lambda i, j: frames.get((i, j)))
        for n in g.permutation(len(evidence)):
            early.add_evidence(evidence[n])
        made = 0
        while made < steps and early.prepare():
            made += 1
        assert made >= 12
        found = early.conclude(times, tuple(frames), evidence)
        for field in ("image_matrices", "cad_matrix", "row_motion"):
            assert all(np.array_equal(a, b) for a, b in zip(flat(found, field), flat(at_end, field), strict=True))


def flat(stitch: Any, name: str) -> list[Any]:
    """Return a field of a result as a list of matrices."""
    value = getattr(stitch, name)
    return [m for row in value for m in row if m is not None] if name == "image_matrices" else list(value)


def test_a_camera_that_sees_a_pattern_is_outvoted_only_by_cameras_that_agree(workshop: Any) -> None:
    """Two cameras of which one has a rival; then both have one; then they found different motions."""
    present, at = tuple((i, j) for i in range(2) for j in range(2)), np.full((30, 2), 20.0)

    def decided(rivals: tuple[Any, Any], motions: tuple[float, float]) -> bool:
        """Return whether the step is decided without a look at the frames."""
        links = tuple(
            Links(
                Task("rows", (i, 0), (i, 1), 0.1), at, at + (0.0, 100.0), np.zeros((30, 2, 2)),
                np.ones(30), coarse_px=(0.0, 0.0), tried=32, rival_px=rivals[i],
            )
            for i in range(2)
        )  # fmt: skip
        each = np.repeat([(0.0, motion) for motion in motions], 30, axis=0), np.repeat([0, 1], 30)

        def prepared(key: Any) -> Any:
            raise LookupError

        cameras = (workshop.camera(), workshop.camera((15, 0)))
        relinker = Relinker(cameras, np.array([0.0, 100.0]), prepared, lambda _: each)
        try:
            return relinker.relinked({(0, 1): links}, present, np.array([0.0, 0.1])) == {(0, 1): links}
        except LookupError:
            return False

    assert decided((None, None), (10.0, 10.0))
    assert decided((None, (0.0, 4.0)), (10.0, 10.0))
    assert not decided(((0.0, 4.0), (0.0, 4.0)), (10.0, 10.0))
    assert not decided((None, (0.0, 4.0)), (10.0, 14.0))
