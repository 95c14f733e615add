from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

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


def test_an_absent_part_shows_its_pads(small: Twin) -> None:
    ref = small.parts[0].ref
    faults = small.scenario.faults.model_validate({"absent_parts": [{"board": 1, "ref": ref}]})
    twin = Twin(small.scenario.model_copy(update={"faults": faults}))
    assert twin.passage(1).placements[ref] is None
    assert twin.passage(0).placements[ref] is not None
    camera, row, *_ = twin.passage(1).truth()["views"][ref][0]
    assert not np.array_equal(twin.passage(1).frame(camera, row), small.passage(1).frame(camera, row))


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
