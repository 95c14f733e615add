from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.simulation import Twin

Make = Callable[..., Twin]
FAULTS = {
    "lost_frames": [{"board": 1, "camera": 0, "row": 2}],
    "lost_rows": [{"row": 3}],
    "late_frames": [{"board": 1, "camera": 0, "row": 0, "delay_s": 0.2}],
    "incomplete_frames": [{"board": 1, "camera": 0, "row": 1, "share": 0.4}],
    "bounces": [{"board": 1, "at_s": 0.05, "duration_s": 0.002}, {"at_s": -0.02, "duration_s": 0.001}],
}


def test_faults_apply_to_the_board_camera_and_row_they_name(make: Make) -> None:
    twin = make(faults=FAULTS)
    hit, other = twin.passage(1).faults, twin.passage(0).faults
    assert [hit.lost(0, r) for r in range(5)] == [False, False, True, True, False]
    assert [other.lost(0, r) for r in range(5)] == [False, False, False, True, False]
    assert (hit.delay_s(0, 0), hit.delay_s(0, 1), other.delay_s(0, 0)) == (0.2, 0.0, 0.0)
    assert (hit.received_share(0, 1), hit.received_share(0, 2), other.received_share(0, 1)) == (0.4, 0.0, 1.0)
    assert hit.stuck is None


def test_faults_of_the_trigger(make: Make) -> None:
    twin = make(
        faults={
            "ignored_triggers": [{"board": 1, "camera": 0, "row": 2}],
            "extra_frames": [{"board": 1, "camera": 0, "row": 1, "after_s": 0.02}],
            "exchanged_frames": [{"board": 1, "camera": 0, "row": 3}],
            "free_running": [{"board": 2, "camera": 0, "interval_s": 0.03}],
        }
    )
    hit, other = twin.passage(1).faults, twin.passage(0).faults
    assert [hit.ignored(0, r) for r in range(4)] == [False, False, True, False]
    assert (hit.received_share(0, 2), other.received_share(0, 2)) == (0.0, 1.0)
    assert (hit.extra_delays_s(0, 1), hit.extra_delays_s(0, 2), other.extra_delays_s(0, 1)) == ((0.02,), (), ())
    assert [hit.metadata_row(0, r) for r in range(6)] == [0, 1, 2, 4, 3, 5]
    assert [other.metadata_row(0, r) for r in range(6)] == [0, 1, 2, 3, 4, 5]
    assert (hit.free_running_interval_s(0), twin.passage(2).faults.free_running_interval_s(0)) == (None, 0.03)


def test_bounces_count_from_the_interruption_in_order(make: Make) -> None:
    passage = make(faults=FAULTS).passage(1)
    assert [b.at_s - passage.blocked_s for b in passage.faults.bounces] == pytest.approx([-0.02, 0.05])
    assert len(make(faults=FAULTS).passage(0).faults.bounces) == 1


def test_frames_that_do_not_arrive_whole_are_missing_in_a_recording(make: Make) -> None:
    passage = make(faults=FAULTS).passage(1)
    assert passage.head().missing == ((0, 1), (0, 2), (0, 3))
    assert [(c, r) for c, r, _ in passage.frames()] == [(0, r) for r in range(passage.rows) if r not in (1, 2, 3)]
    assert len(passage.render_all()) == passage.rows


def test_an_absent_part_shows_its_pads(small: Twin) -> None:
    ref = small.parts[0].ref
    faults = small.scenario.faults.model_validate({"absent_parts": [{"board": 1, "ref": ref}]})
    twin = Twin(small.scenario.model_copy(update={"faults": faults}))
    assert twin.passage(1).placements[ref] is None
    assert twin.passage(0).placements[ref] is not None
    camera, row, *_ = twin.passage(1).truth()["views"][ref][0]
    assert not np.array_equal(twin.passage(1).frame(camera, row), small.passage(1).frame(camera, row))


def test_an_absent_part_must_be_one_of_the_board_s(make: Make) -> None:
    twin = make(faults={"absent_parts": [{"ref": "X99"}]})
    with pytest.raises(InputError, match="X99"):
        twin.passage(0).frame(0, 0)


@pytest.mark.parametrize(("about", "way"), [("x", (0.0, -1.0)), ("y", (1.0, 0.0))])
def test_a_knocked_camera_looks_elsewhere_from_its_board_on(make: Make, about: str, way: tuple[float, float]) -> None:
    """By the focal length times the angle in the middle of its frame; it hangs where it hung."""
    twin = make(
        array={"cameras": 2}, faults={"knocked": [{"camera": 1, "from_board": 2, "about": about, "angle_deg": 0.1}]}
    )
    before, after = twin.passage(1), twin.passage(2)
    assert before.pinholes == twin.pinholes
    assert after.pinholes[0] is twin.pinholes[0]
    middle = np.array([[79.5, 59.5]])
    moved = after.pinholes[1].project(twin.pinholes[1].ground(middle, 0.0), 0.0) - middle
    assert moved[0] == pytest.approx(np.multiply(way, 200 * 10 * np.radians(0.1)), rel=0.01, abs=0.01)
    lifted = after.pinholes[1].calibrated(200.0)
    assert lifted.foot_mm == pytest.approx(twin.pinholes[1].foot_mm, abs=0.02)
    assert after.truth()["image_matrices"][1][0] != before.truth()["image_matrices"][1][0]


def test_a_knocked_camera_must_exist(make: Make) -> None:
    with pytest.raises(ValueError, match="a fault names camera 3"):
        make(faults={"knocked": [{"camera": 3, "angle_deg": 0.1}]})


def test_the_earliest_of_several_stops_counts(make: Make) -> None:
    twin = make(faults={"stuck": [{"row": 4}, {"board": 1, "row": 2}]})
    assert [twin.passage(k).faults.stuck for k in (0, 1)] == [4, 2]


def test_the_worst_of_several_faults_of_a_frame_counts(make: Make) -> None:
    twin = make(
        faults={
            "late_frames": [{"camera": 0, "row": 0, "delay_s": d} for d in (0.1, 0.3)],
            "incomplete_frames": [{"camera": 0, "row": 1, "share": s} for s in (0.7, 0.2)],
        }
    )
    faults = twin.passage(0).faults
    assert (faults.delay_s(0, 0), faults.received_share(0, 1)) == (0.3, 0.2)
