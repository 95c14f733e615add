"""Dark lights: rows of a light that are black between bright ones; a bare belt or a covered camera is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.hostile.judging import judge
from tests.stitching.quality.test_findings import findings_of
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import ReasonCode
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import Observations
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.quality.confirmation import (
    DarkLight,
    confirmed_beside,
    dark_light_reasons,
    dark_lights,
)
from vaoi_station.stitching.quality.verdict import judge_result

STEP_MM = 10.0
MOTION = Motion(np.zeros(3), np.array([(0.0, 0.0), (-STEP_MM, 0.0), (-2 * STEP_MM, 0.0)]), np.zeros(2))
"""The board is carried 10 mm along x from row to row."""


def observed(*pairs: tuple[Task, Floats]) -> Observations:
    """Return links of pairs of frames, each with the way (k, 2) between its two points, mm."""
    count = [len(way) for _, way in pairs]
    a_mm = np.concatenate([np.linspace((0, 0), (5, 40), len(way)) for _, way in pairs])
    way_mm = np.concatenate([way for _, way in pairs])
    group = np.repeat(np.arange(len(pairs)), count)
    p = np.array([task.a[1] for task, _ in pairs])[group]
    q = np.array([(task.b or task.a)[1] for task, _ in pairs])[group]
    camera_a = np.array([task.a[0] for task, _ in pairs])[group]
    camera_b = np.array([(task.b or task.a)[0] for task, _ in pairs])[group]
    zero = np.zeros_like(a_mm)
    empty = tuple(Links.empty(task, "") for task, _ in pairs)
    noise, ones = np.zeros((len(a_mm), 2, 2)), np.ones(len(a_mm))
    return Observations(p, q, camera_a, camera_b, group, a_mm, a_mm + way_mm, zero, zero, noise, ones, ones, empty)


def ways(*mm: float) -> Floats:
    return np.array([(x, 0.0) for x in mm])


ROWS = Task("rows", (0, 0), (0, 1))


@pytest.mark.parametrize(
    ("way_mm", "confirmed"),
    [
        (STEP_MM, True),
        (STEP_MM * 0.985, True),  # a carrier below the board
        (0.0, False),  # the picture of the row before, or dirt on the lens
        (2 * STEP_MM, False),  # the picture of a later row
        (STEP_MM * 0.9, False),
    ],
)
def test_a_carrier_confirms_a_frame_only_if_it_moves_with_the_board(way_mm: float, confirmed: bool) -> None:
    beside = observed((ROWS, ways(*[way_mm] * 8)))
    assert confirmed_beside(beside, MOTION) == ({(0, 0), (0, 1)} if confirmed else set())


def test_a_copy_is_not_confirmed_by_the_edge_of_a_carrier() -> None:
    """A frame shows the moment of the one before it; 7 of 8 links along an edge fit (hostile seed 90096)."""
    assert judge(90096).finds == ()


def test_a_frame_that_shows_almost_only_the_carrier_is_no_reason() -> None:
    """The first frame of camera 0 shows five components, but all its links lie on the carrier (hostile seed 71014)."""
    outcome = judge(71014)
    assert (outcome.status, outcome.finds) == ("ok", ()), outcome.reasons


LIGHTS, CHANNELS = ("even", "left", "right") * 3, {"left": (2,), "right": (0, 3)}
BRIGHT = np.tile(np.arange(0, 240, 3, dtype=np.uint8), (64, 1))
DARK = np.full_like(BRIGHT, 4)


def scene(workshop: Any, frames: dict[tuple[int, int], Any]) -> Scene:
    cameras = (workshop.camera((0, 0)), workshop.camera((17, 0)))
    return Scene(cameras, tuple(sorted(frames)), lambda key: PreparedFrame(frames[key]))


def frames(dark: set[int], cameras: int = 2) -> dict[tuple[int, int], Any]:
    return {(i, j): DARK if j in dark else BRIGHT for i in range(cameras) for j in range(9)}


def found(workshop: Any, dark: set[int], unlinked: set[int] | None = None) -> tuple[DarkLight, ...]:
    there = frames(dark)
    confirmed = [key for key in there if key[1] not in (dark if unlinked is None else unlinked)]
    return dark_lights(scene(workshop, there), LIGHTS, CHANNELS, confirmed)


def test_a_light_that_fails_in_the_run_is_named_with_its_rows(workshop: Any) -> None:
    assert found(workshop, set()) == ()
    (left,) = found(workshop, {4, 7})
    assert (left.name, left.rows, left.of_rows) == ("left", (4, 7), 3)
    (reason,) = dark_light_reasons([left])
    assert reason.code == ReasonCode.LIGHT_DARK
    assert reason.message == (
        "light left: rows 4, 7 are dark (2 of its 3 rows), while the rows beside are bright: check lamp, driver and "
        "cable of LED channel 2, and film the board again"
    )
    first, second = dark_light_reasons(found(workshop, {1, 2, 5}))
    assert "light left: row 1 is dark (1 of its 3 rows)" in first.message
    assert "LED channels 0, 3" in second.message


def test_the_verdict_of_a_run_names_the_light_and_not_its_frames(filmed: Any) -> None:
    there = {key: np.full_like(p, 5) if key[1] in (2, 5) else p for key, p in filmed.frames.items()}
    findings = findings_of(filmed, there, lights=("even", "right", "left"), channels={"left": (2,)})
    status, reasons = judge_result(findings)
    assert status != "ok"
    named = {reason.code: reason.message for reason in reasons}
    assert "LED channel 2" in named[ReasonCode.LIGHT_DARK]
    assert "rows 2, 5 are dark" in named[ReasonCode.LIGHT_DARK]
    assert ReasonCode.FRAMES_UNCONFIRMED not in named
