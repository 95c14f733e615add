"""Reasons for rows whose distance from the others only the belt's nominal speed gives."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import ReasonCode, Status
from vaoi_station.stitching.adjustment.problem import Influence
from vaoi_station.stitching.quality.verdict import decide_verdict, disputed_positions, scattered_links


def test_unconnected_rows_are_a_reason(filmed: Any) -> None:
    """Two blank rows: only the belt gives the distance of the second half from the first, and belts stop."""
    frames = {key: np.full_like(p, 20) if key[1] in (2, 3) else p for key, p in filmed.frames.items()}
    result = filmed.stitched(frames=frames)
    assert result.status is not Status.OK
    assert any("no links connect the rows 0–3 with the rows" in r for r in result.reasons), result.reasons
    assert any("other rows are not placed: film the board again" in r for r in result.reasons), result.reasons
    assert result.quality["unplaced_rows"] == [0, 1, 2, 3]
    assert [m is not None for m in result.image_matrices[0]] == [False] * 4 + [True] * 2
    assert result.components is not None
    assert {row for views in result.components.values() for _, row, *_ in views} <= {4, 5}


@pytest.mark.parametrize("lost", [(1, 2), (2, 3), (3, 4)])
def test_lost_rows_are_blamed_before_the_fiducials(filmed: Any, lost: tuple[int, ...]) -> None:
    """Rows beside the gap do not overlap: only the belt's speed, here wrong by 3 %, places one part by the other."""
    there = {key: p for key, p in filmed.frames.items() if key[1] not in lost}
    slow = tuple(0.97 * v for v in filmed.setup.conveyor_mm_s)
    reasons = decide_verdict(findings_of(filmed, there, conveyor_mm_s=slow))[1]
    assert reasons[0].code == "rows-lost", reasons
    assert f"of rows {', '.join(map(str, lost))}" in reasons[0].text


@pytest.mark.parametrize(
    ("floor_px", "noise_px", "named"),
    [
        (0.31, 0.3, "not rigid or flat"),
        (0.29, 0.15, ""),  # a dark or blurred picture: σ contains its noise
        (0.18, 0.03, "does not move as one board"),
        (0.14, 0.03, ""),
    ],
)
def test_scatter_of_links_that_noise_does_not_explain_is_a_reason(
    filmed: Any, floor_px: float, noise_px: float, named: str
) -> None:
    found = findings_of(filmed)
    links = found.problem.links
    noise = np.tile(np.eye(2), (len(links), 1, 1)) * (noise_px / links.px_per_mm[:, None, None]) ** 2
    problem = replace(found.problem, links=replace(links, noise_mm2=noise))
    doubtful = SimpleNamespace(problem=problem, adjusted=replace(found.adjusted, floor_px=floor_px))
    reasons = list(scattered_links(doubtful))  # type: ignore[arg-type]
    assert [r.code for r in reasons] == [ReasonCode.LINKS_SCATTER] * bool(named)
    assert all(named in r.text for r in reasons)


@pytest.mark.parametrize(
    ("of_marks", "named"),
    [
        (False, "positions in row 0 follow from few places of the pictures"),
        (True, "without one of the marks that place the board (fiducials, fixture, reference) positions move by"),
    ],
)
def test_what_decides_positions_beyond_noise_widens_sigma_and_is_named(filmed: Any, of_marks: bool, named: str) -> None:
    """Without the links of one place, or one mark, row 0 moves by 0.5 px more than noise explains."""
    found = findings_of(filmed)
    assert decide_verdict(found)[0] is Status.OK
    assert disputed_positions(found, 0.2) == ""
    m, u = found.adjusted.covariance.shape[:2]
    change = np.zeros((1, m, u))
    # The gauge holds row 0: the other rows and C move against it.
    change[0, 1:, 2] = change[0, :, 6] = 0.5 / found.scene.cameras[0].px_per_mm
    influence = Influence(change, np.zeros((1, m, u, u)), np.full((1, 4), not of_marks), 1)
    assert found.mapping is not None
    disputed = replace(found, found=replace(found.mapping, adjusted=replace(found.adjusted, influence=influence)))
    assert disputed.sigma.rows_px[0] == pytest.approx(0.5, abs=0.03)
    assert disputed.sigma.rows_px[1:] == found.sigma.rows_px[1:]
    status, reasons = decide_verdict(disputed)
    assert (status, [r.code for r in reasons]) == (Status.DEGRADED, [ReasonCode.POSITIONS_UNCERTAIN])
    assert named in reasons[0].text
