"""Texture beside the board: carriers and belts with texture, on films of the twin with known truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType, ReasonCode, Status
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import Problem, to_observations
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.outline import link_depths_mm, outline_confirmed, without_links_beside
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

MARKS = ((-5.0, 4.0), (-5.0, 34.4), (65.0, 20.0), (30.0, -5.0), (30.0, 45.0))


def filmed_with(**sections: dict[str, Any]) -> tuple[Twin, Any, Any]:
    """Film the small board with other surroundings; return the twin, the passage and the result."""
    document = read_scenario(scenario_path("small")).model_dump()
    for name, section in sections.items():
        document[name] = document[name] | section
    twin = Twin(Scenario.model_validate(document))
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    setup = StitchSetup(
        twin.calibration.cameras(head.cameras), head.conveyor_mm_s, head.trigger_period_s, twin.board_type
    )
    runner, times = TaskRunner(setup, lambda i, j: frames.get((i, j))), head.row_times_s()
    evidence = [runner.perform(task) for task in all_tasks(frames, dict(enumerate(times)), setup)]
    return twin, passage, runner.conclude(times, tuple(frames), evidence)


def worst_px(result: Any, passage: Any) -> float:
    ours = {(ref, i, j): (x, y) for ref, views in result.components.items() for i, j, x, y in views}
    off = [
        np.hypot(ours[ref, i, j][0] - x, ours[ref, i, j][1] - y)
        for ref, views in passage.truth()["views"].items()
        for i, j, x, y in views
    ]
    return float(max(off))


BELTS: dict[str, dict[str, Any]] = {
    "dirty belt": {"texture": {"sigma_grey": 15.0}},
    "dirty belt below": {"texture": {"sigma_grey": 15.0, "below_mm": 1.6}},
    "bed with texture": {"texture": {"sigma_grey": 30.0, "follows": 0.0}},
    "bed below": {"texture": {"sigma_grey": 15.0, "follows": 0.0, "below_mm": 1.6}},
    "half the speed": {"texture": {"sigma_grey": 15.0, "follows": 0.5, "below_mm": 1.6}},
    "carrier with marks": {"carrier": {"rim_mm": 9.0, "marks": [{"x_mm": x, "y_mm": y} for x, y in MARKS]}},
    "dark carrier below": {"carrier": {"rim_mm": 9.0, "grey": 25.0, "sigma_grey": 15.0, "below_mm": 1.6}},
    "few parts on a bed": {
        "board": {"density": 0.1, "width_mm": 36.0},
        "texture": {"sigma_grey": 15.0, "follows": 0.0},
    },
}


@pytest.mark.parametrize("sections", BELTS.values(), ids=BELTS)
def test_texture_beside_the_board_does_not_move_it(sections: dict[str, dict[str, Any]]) -> None:
    _, passage, result = filmed_with(**sections)
    assert result.status is Status.OK, result.reasons
    assert worst_px(result, passage) < 0.2


def test_a_carrier_as_bright_as_the_board_is_named() -> None:
    """The place is right, and three fiducials leave no doubt of it, but no picture confirms where the board ends."""
    _, passage, result = filmed_with(carrier={"rim_mm": 9.0, "grey": 60.0})
    assert result.status is Status.DEGRADED
    assert result.reason_codes == (ReasonCode.OUTLINE_INVISIBLE,)
    assert worst_px(result, passage) < 0.2


def plane_of(outline: list[list[float]], **keys: Any) -> BoardPlane:
    data = {"name": "b", "unit": "mm", "y_axis": "up", "side": "top"}
    return BoardPlane(BoardType.model_validate(data | {"outline": outline, "fiducials": []} | keys), mirrored=False)


C = np.array([1.0, 0.0, 5.0, 0.0])
"""C that shifts the board by 5 mm along x."""


def test_links_between_cameras_beside_the_board_are_left_out(workshop: Any) -> None:
    """They lie on a bed at another height, which bends the estimated surface; those between rows show the motion."""
    cameras = (workshop.camera(), workshop.camera())
    places = np.array([[10.0, 5.0], [10.0, 15.0], [15.0, 10.5], [30.0, 5.0]])
    px = cameras[0].project(places)
    tasks = Task("neighbours", (0, 0), (1, 0)), Task("rows", (0, 0), (0, 1))
    found = [Links(task, px, px, np.tile(np.eye(2), (4, 1, 1)), np.ones(4)) for task in tasks]
    velocity, times = np.array([0.0, 50.0]), np.array([0.0, 0.1])
    problem = Problem(times, velocity, to_observations(found, cameras), np.full(8, -1))
    motion = Motion(np.zeros(2), np.zeros((2, 2)), np.zeros(2))
    plane = plane_of([[0, 0], [20, 10]])
    depth_mm = link_depths_mm(plane, C, problem.links, motion)
    kept = without_links_beside(problem, depth_mm, lambda: False)
    np.testing.assert_allclose(kept.links.a_mm, [places[0], *places], atol=1e-9)
    assert len(kept.component) == 5
    kept = without_links_beside(problem, depth_mm, lambda: True)
    np.testing.assert_allclose(kept.links.a_mm, places[[0, 0]], atol=1e-9)


@pytest.mark.parametrize(("shift_mm", "confirmed"), [(0.2, True), (2.0, False)])
def test_an_outline_is_confirmed_only_in_its_place(shift_mm: float, confirmed: bool) -> None:
    twin, passage, result = filmed_with(texture={"sigma_grey": 15.0})
    head, frames = passage.head(), passage.render_all()
    scene = Scene(twin.calibration.cameras(head.cameras), tuple(sorted(frames)), lambda key: PreparedFrame(frames[key]))
    poses = [np.asarray(d) for d in passage.truth()["row_motion"]]
    angle = np.array([-np.arctan2(d[1, 0], d[0, 0]) for d in poses])
    shift = np.array([np.linalg.inv(d)[:2, 2] for d in poses])
    cad = np.array(passage.truth()["cad_matrix"])
    cad[:2, 2] += shift_mm
    motion = Motion(angle, shift, np.zeros(2))
    assert outline_confirmed(BoardPlane(twin.board_type, mirrored=False), cad, scene, motion) is confirmed
    assert result.status is Status.OK


OUTLINE = [[-11.0, -7.0], [11.0, -7.0], [11.0, 7.0], [-11.0, 7.0]]
STILL = Motion(np.zeros(1), np.zeros((1, 2)), np.zeros(2))


def with_bright_box(workshop: Any, middle: tuple[float, float], half: tuple[float, float]) -> Scene:
    """Draw a board of 22 mm × 14 mm with a box on it that is brighter than its edges."""
    camera = workshop.camera((0.0, 0.0), size_px=(480, 320), px_per_mm=15.0)
    y, x = np.mgrid[:320, :480].astype(float)
    tester = camera.ground(np.stack([x, y], -1).reshape(-1, 2)).reshape(320, 480, 2)
    levels = np.where((np.abs(tester) <= (11.0, 7.0)).all(-1), 100.0, 60.0)
    levels[(np.abs(tester - middle) <= half).all(-1)] = 220.0
    frame = PreparedFrame(workshop.digitised(levels + np.random.default_rng(1).normal(0, 2, levels.shape)))
    return Scene((camera,), ((0, 0),), lambda key: frame)


def test_a_marking_between_two_connectors_is_no_other_edge_of_the_board(workshop: Any) -> None:
    """Of five pieces of a side, only one is not hidden by them, and shows a stronger edge (seed 96313)."""
    scene = with_bright_box(workshop, (0.0, 3.0), (10.6, 1.5))
    two = [{"ref": f"J{n}", "center": [x, 3.0], "width": 7.0, "height": 3.0} for n, x in ((1, -7.1), (2, 7.1))]
    assert outline_confirmed(plane_of(OUTLINE, components=two), np.eye(3), scene, STILL)
    assert not outline_confirmed(plane_of(OUTLINE, components=two[:1]), np.eye(3), scene, STILL)


def test_two_fiducials_in_a_carrier_as_bright_as_the_board_fail_with_the_cause() -> None:
    """Two marks may be any two: without edges that confirm them, they are no place of the board."""
    marks = [{"x_mm": 4.0, "y_mm": 4.0}, {"x_mm": 52.0, "y_mm": 36.0}]
    _, _, result = filmed_with(carrier={"rim_mm": 9.0, "grey": 62.0}, board={"fiducials": marks})
    assert result.status is Status.FAILED, result.reasons
    assert "2 of them fit, but the edges of the board do not show" in result.reasons[0]
