"""Dark lights: rows of a light that are black between bright ones; a bare belt or a covered camera is none."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import ReasonCode
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.quality.confirmation import DarkLight, RowLights, dark_light_reasons, dark_lights
from vaoi_station.stitching.quality.verdict import decide_verdict

LIGHTS = RowLights(("even", "left", "right") * 3, {"left": (2,), "right": (0, 3)})
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
    return dark_lights(scene(workshop, there), LIGHTS, confirmed)


def test_a_light_that_fails_in_the_run_is_named_with_its_rows(workshop: Any) -> None:
    assert found(workshop, set()) == ()
    (left,) = found(workshop, {4, 7})
    assert (left.name, left.rows, left.of_rows) == ("left", (4, 7), 3)
    (reason,) = dark_light_reasons([left])
    assert reason.code is ReasonCode.LIGHT_DARK
    assert reason.text == (
        "light left: rows 4, 7 are dark (2 of its 3 rows), while the rows beside are bright: check lamp, driver and "
        "cable of LED channel 2, and film the board again"
    )
    first, second = dark_light_reasons(found(workshop, {1, 2, 5}))
    assert "light left: row 1 is dark (1 of its 3 rows)" in first.text
    assert "LED channels 0, 3" in second.text


def test_rows_of_a_bare_belt_are_not_dark_lights(workshop: Any) -> None:
    """The board has left after row 5. The row beside the last sound one counts only with another one inside."""
    assert found(workshop, {6, 7, 8}) == ()
    assert found(workshop, {0}) == ()
    (right,) = found(workshop, {5, 8})
    assert right.rows == (5, 8)


def test_blurred_covered_and_unnamed_rows_are_not_dark_lights(workshop: Any) -> None:
    assert found(workshop, set(), unlinked={4}) == (), "bright, but without links"
    covered = frames(set()) | {(0, 4): DARK}
    bright = [key for key in covered if key[1] != 4]
    assert dark_lights(scene(workshop, covered), LIGHTS, bright) == (), "one camera shows light"
    dim = {key: (pixels // 30).astype(np.uint8) for key, pixels in frames({4}).items()}
    assert dark_lights(scene(workshop, dim), LIGHTS, bright) == (), "all rows are dim"
    assert dark_lights(scene(workshop, frames({4})), RowLights(), bright) == ()
    assert dark_lights(scene(workshop, frames({4})), LIGHTS, []) == ()


def test_the_verdict_of_a_run_names_the_light_and_not_its_frames(filmed: Any) -> None:
    there = {key: np.full_like(p, 5) if key[1] in (2, 5) else p for key, p in filmed.frames.items()}
    findings = findings_of(filmed, there, lights=("even", "right", "left"), channels={"left": (2,)})
    status, reasons = decide_verdict(findings)
    assert status != "ok"
    named = {reason.code: reason.text for reason in reasons}
    assert "LED channel 2" in named[ReasonCode.LIGHT_DARK]
    assert "rows 2, 5 are dark" in named[ReasonCode.LIGHT_DARK]
    assert ReasonCode.FRAMES_UNCONFIRMED not in named
