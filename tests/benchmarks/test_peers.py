"""The comparison with other stitchers, except for the stitchers themselves: strips, scores, table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benchmarks.peers import place, render_strips, table
from tests.benchmarks.peers.adapters import ours
from tests.benchmarks.peers.strip import Floats, Matrices

SMALL: dict[str, dict[str, Any]] = {
    "array": {"cameras": 2, "width_px": 320, "height_px": 240, "px_per_mm": 12.0, "working_distance_mm": 300.0},
    "board": {"width_mm": 64.0, "length_mm": 76.0, "density": 6.0},
    "line": {"barrier_mm": -50.0, "tail_s": 1.0},
}


@pytest.fixture(scope="module", params=["plain", "yaw", "line"])
def rendered(request: pytest.FixtureRequest) -> render_strips.RenderedStrip:
    variant = str(request.param)
    return render_strips.render_strip(variant, render_strips.twin_of(variant, **SMALL))


def shifted(true: Floats, by_px: Floats) -> Matrices:
    return [np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ m for m, (x, y) in zip(true, by_px, strict=True)]


def test_frames_agree_with_the_truth(rendered: render_strips.RenderedStrip) -> None:
    """Neighbours in a column correlate when aligned by the truth, and less when shifted by three pixels."""
    frames, true = rendered.strip.frames.astype(np.float64), rendered.board_from_flat
    assert len(frames) == 2 * render_strips.ROWS
    x, y = np.meshgrid(np.arange(60, 260), np.arange(30, 70))
    later_from_earlier = np.linalg.inv(true[2]) @ true[0]
    dx, dy = np.rint(later_from_earlier[:2, 2]).astype(int)
    assert 100 < dy < 150, "the belt moves the image down by about 10.5 mm per row"

    def correlation(off: int) -> float:
        return float(np.corrcoef(frames[0][y, x].ravel(), frames[2][y + dy, x + dx + off].ravel())[0, 1])

    assert correlation(0) > 0.9
    assert correlation(0) > max(correlation(-3), correlation(3))


def test_our_stitcher_runs_and_is_scored_like_a_peer(rendered: render_strips.RenderedStrip, tmp_path: Path) -> None:
    strips = tmp_path / "strips"
    rendered.write(strips / rendered.strip.name)
    runs = list(place.run(ours, [strips / rendered.strip.name]))
    assert [run["setting"] for run in runs] == list(ours.SETTINGS)
    lines = [json.dumps({"name": "ours"} | run) for run in runs]
    for run in table.scored(lines, strips):
        # Frames of 320 × 240 px in a disturbed line show too little for more: 0.03 to 0.4 px on boards of other seeds.
        assert run["rms_px"] < 0.2
        assert run["cpu_s"] > 0
        assert "matrices" not in run


def test_page_agrees_with_the_stored_results() -> None:
    part = table.page_part(json.loads(table.RESULTS.read_text()))
    assert part in table.PAGE.read_text()
