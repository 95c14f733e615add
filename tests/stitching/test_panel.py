"""A panel of four boards, each displaced by 0.2 mm and turned by 0.1°, against the twin's truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.stitching.conftest import Filmed
from vaoi_station.clamping import ClampedRequest, FilmedBoard, Reading, clamp
from vaoi_station.files.documents import read_toml
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.hdr.merging import bodies_in, region_component, views_on_top
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.mosaic import MosaicGrid, choose_frames, make_plan
from vaoi_station.mosaic.frames import frames_of_head
from vaoi_station.rendering import ViewCalculator
from vaoi_station.simulation import Scenario, Twin, scenario_path
from vaoi_station.steps import completed
from vaoi_station.stitching.work import StitchSetup

BOARDS = [
    {"x_mm": 4.0, "y_mm": 4.0, "shift_mm": [0.2, -0.1], "turn_deg": 0.1},
    {"x_mm": 32.0, "y_mm": 4.0, "rotated_deg": 180, "shift_mm": [-0.15, 0.12], "turn_deg": -0.1, "mark": "bad"},
    {"x_mm": 4.0, "y_mm": 30.0, "shift_mm": [0.0, 0.2], "turn_deg": 0.05, "mark": "half"},
    {"x_mm": 32.0, "y_mm": 30.0, "shift_mm": [-0.2, -0.2], "turn_deg": 0.1},
]


@pytest.fixture(scope="module")
def panel() -> Filmed:
    data = read_toml(scenario_path("small"))
    data["board"] = {
        "name": "panel",
        "width_mm": 62.0,
        "length_mm": 58.0,
        "density": 3.0,
        "fiducials": [{"x_mm": 2.0, "y_mm": 2.0}, {"x_mm": 60.0, "y_mm": 2.0}, {"x_mm": 2.0, "y_mm": 56.0}],
        "panel": {
            "width_mm": 26.0,
            "length_mm": 24.0,
            "boards": BOARDS,
            "fiducials": [{"x_mm": 2.0, "y_mm": 2.0}, {"x_mm": 24.0, "y_mm": 21.0}],
            "bad_mark": {"x_mm": 13.0, "y_mm": 2.0, "diameter_mm": 1.5},
        },
    }
    twin = Twin(Scenario.model_validate(data))
    passage = twin.passage(0)
    head = passage.head()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    return Filmed(head, twin.calibration, setup, passage.render_all(), passage.truth())


def changed(board_type: BoardType, fiducials: list[dict[str, Any]]) -> BoardType:
    """Return the board type with other fiducials."""
    return BoardType.model_validate(board_type.model_dump(exclude_none=True) | {"fiducials": fiducials})


def fiducials_of(board_type: BoardType) -> list[dict[str, Any]]:
    return [f.model_dump(exclude_none=True) for f in board_type.fiducials]


def error_mm(panel: Filmed, result: Stitch, position: str) -> float:
    """Largest distance of a component of one board from its true place, tester coordinates."""
    parts = np.array([c.center for c in panel.board_type.components if c.panel == position])
    assert result.board_matrices is not None
    truth = np.array(panel.truth["board_matrices"][position])
    own = result.board_matrices.get(position, result.cad_matrix)
    assert own is not None
    return float(np.hypot(*(apply(own, parts) - apply(truth, parts)).T).max())


def test_every_board_lies_where_its_fiducials_put_it(panel: Filmed) -> None:
    result = panel.stitched(board_type=panel.board_type.model_copy(update={"other_marks": None}))
    assert result.status is Status.OK, result.reasons
    assert panel.error_px(result) <= 0.05
    shown = result.quality["boards"]["1"]
    assert shown["turn_deg"] == pytest.approx(-0.1, abs=4 * shown["sigma_turn_deg"]), "tester y points the other way"
    assert 0.2 < np.hypot(*shown["shift_mm"]) < 0.25
    assert set(result.board_matrices or ()) == {"1", "2", "3", "4"}
    assert panel.error_px(result) < 4 * result.quality["cad_sigma_px"]


def test_a_board_that_is_crossed_out_is_skipped_and_a_doubtful_mark_is_named(panel: Filmed) -> None:
    result = panel.stitch
    states = {at: board["state"] for at, board in result.quality["boards"].items()}
    assert states == {"1": "good", "2": "bad", "3": "doubtful", "4": "good"}
    assert result.skipped_boards == ("2",)
    assert result.reason_codes == ("bad-board-doubtful",)
    assert (
        "board 3 of the panel is crossed out, so it is not skipped: mark BBM3 at CAD (17, 26), camera"
        in result.reasons[0]
    )


def test_nothing_is_demanded_of_a_board_that_is_crossed_out(panel: Filmed) -> None:
    """Its fiducials are not there, and the frames that show it were lost."""
    marks = fiducials_of(panel.board_type)
    for mark in marks[5:7]:
        mark["y"] -= 3.0
    parts = [
        c.model_dump(exclude_none=True) | ({"visibility": {"views": 9}} if c.panel == "2" else {})
        for c in panel.board_type.components
    ]
    asked = changed(panel.board_type, marks).model_dump(exclude_none=True) | {"components": parts}
    others = [m for m in asked["other_marks"] if m["panel"] != "3"]
    result = panel.stitched(board_type=BoardType.model_validate(asked | {"other_marks": others}))
    assert result.status is Status.OK, result.reasons
    assert result.skipped_boards == ("2",)
    assert result.quality["unseen"] == {}
    tested = [m for m in others if m["panel"] != "2"]
    result = panel.stitched(board_type=BoardType.model_validate(asked | {"other_marks": tested}))
    assert {"board-unplaced", "positions-uncertain", "components-unseen"} == set(result.reason_codes)
    ordered = replace(panel.setup.expectation, skipped=("2",))
    result = panel.stitched(board_type=BoardType.model_validate(asked | {"other_marks": tested}), expectation=ordered)
    assert (result.status, result.skipped_boards) == (Status.OK, ("2",)), "its order says that it is not to be tested"


def test_views_and_component_images_follow_the_board(panel: Filmed) -> None:
    result = panel.stitch
    views = ViewCalculator(panel.board_type, result, panel.setup.cameras).compute_all(panel.board_type.components)
    truth = {(ref, i, j): (x, y) for ref, seen in panel.truth["views"].items() for i, j, x, y in seen}
    compared = 0
    for ref, of_part in views.items():
        for view in of_part:
            if (ref, view.camera, view.row) in truth:
                middle = np.array([(view.width - 1) / 2, (view.height - 1) / 2, 1.0])
                x, y, w = view.matrix @ middle
                assert (x / w, y / w) == pytest.approx(truth[ref, view.camera, view.row], abs=0.1)
                compared += 1
    assert compared > 40


def test_pictures_of_the_board_show_bodies_where_their_boards_lie(panel: Filmed) -> None:
    board_type, result, cameras = panel.board_type, panel.stitch, panel.setup.cameras
    assert result.cad_matrix is not None
    back = np.linalg.inv(result.cad_matrix)
    raised = [c for c in board_type.components if c.body_height]
    true = [apply(back @ np.array(panel.truth["board_matrices"][c.panel]), board_type.footprint(c)) for c in raised]
    assert max(np.abs(t - board_type.footprint(c)).max() for t, c in zip(true, raised, strict=True)) > 0.2
    low, high = (corner.tolist() for corner in board_type.extent())
    region = region_component((*low, *high), board_type, 18.0)
    view = views_on_top(ViewCalculator(board_type, result, cameras), region, 0.0, px_per_mm=18.0)[0]
    in_region = [apply(np.linalg.inv(view.crop_matrix), body.corners) for body in bodies_in(view, board_type, result)]
    steps = make_plan(
        choose_frames(frames_of_head(panel.head), hdr=True),
        lambda _, __: None,
        projector=FrameIndex.of_result(result, cameras),
        board_type=board_type,
        stitch=result,
        base=MosaicGrid.of_board(board_type, 18.0),
    )
    in_mosaic = [body.corners for body in completed(steps).bodies]
    for found in (in_region, in_mosaic):
        assert len(found) == len(true) > 20
        # They follow one another by height, which is measured for some.
        assert max(min(np.abs(f - t).max() for f in found) for t in true) < 0.1 / 18


def test_without_fiducials_of_the_panel_one_board_locates_it(panel: Filmed) -> None:
    result = panel.stitched(board_type=changed(panel.board_type, fiducials_of(panel.board_type)[3:]))
    assert result.reason_codes == ("bad-board-doubtful",)
    assert panel.error_px(result) <= 0.05
    assert result.quality["fiducial_check"]["fiducials"] == 2


def test_a_board_without_its_fiducials_follows_the_panel_and_says_so(panel: Filmed) -> None:
    marks = fiducials_of(panel.board_type)
    for mark in marks[-2:]:
        mark["y"] += 3.0
    result = panel.stitched(board_type=changed(panel.board_type, marks))
    assert result.status is Status.DEGRADED
    assert result.reason_codes[0] == "board-unplaced"
    assert "4: 4/FID1, 4/FID2 was not found" in result.reasons[0]
    assert set(result.board_matrices or ()) == {"1", "2", "3"}
    assert result.component_matrix("4/U1") is result.cad_matrix
    sigma = result.quality["component_sigma_px"]
    # 18 px/mm; a board is displaced by 0.2 mm and turned by 0.1° over 13 mm.
    assert sigma["4/U1"] > 0.15 * 18 > 50 * sigma["1/U1"]
    assert error_mm(panel, result, "4") < 3 * sigma["4/U1"] / 18
    assert error_mm(panel, result, "1") < 0.05 / 18


def test_one_fiducial_of_a_board_is_a_doubt(panel: Filmed) -> None:
    result = panel.stitched(board_type=changed(panel.board_type, fiducials_of(panel.board_type)[:-1]))
    assert result.status is Status.DEGRADED
    assert result.reasons[0].startswith("one fiducial alone places 1 of 3 boards of the panel"), "one is skipped"
    assert error_mm(panel, result, "4") < 4 * result.quality["component_sigma_px"]["4/U1"] / 18


@pytest.mark.parametrize("own", [False, True])
def test_boards_of_a_clamped_panel_are_where_they_are_stated(panel: Filmed, own: bool) -> None:
    """Without readings of a board's own fiducials it lies in the panel as it was filmed: displaced by 0.2 mm."""
    random, board = np.random.default_rng(0), panel.board_type
    film = FilmedBoard(board, panel.stitch, float(np.mean([c.px_per_mm for c in panel.setup.cameras])))
    truth = {None: panel.truth["cad_matrix"], **panel.truth["board_matrices"]}
    up = -1 if np.linalg.det(np.array(truth[None])[:2, :2]) < 0 else 1
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])

    def clamped(cad: tuple[float, float], position: object) -> Any:
        place = apply(np.array(truth[None if position is None else str(position)]), np.array(cad))
        return turn @ (place * (1, up)) + (50.0, 70.0)

    marks = [m for m in board.fiducials if own or m.panel is None]
    errors = []
    for _ in range(30):
        noisy = [(m.name, clamped((m.x, m.y), m.panel) + random.normal(0, 0.01, 2)) for m in marks]
        readings = tuple(Reading(fiducial=name, x=x, y=y) for name, (x, y) in noisy)
        request = ClampedRequest(readings=readings, sigma=0.01, points=tuple(c.address for c in board.components))
        answer = clamp(film, request)
        assert [t.board for t in answer.transforms] == [None, *("1234" if own else "")]
        at = np.array([clamped(c.center, c.panel) for c in board.components])
        found = np.array([(p.x, p.y, p.sigma_x, p.sigma_y) for p in answer.points])
        errors.append((found[:, :2] - at) / found[:, 2:])
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.4
