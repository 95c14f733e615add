"""The comparison with other stitchers, except for the stitchers themselves: strips, scores, table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.benchmarks.peers import place, render_strips, table
from tests.benchmarks.peers.adapter import Setting
from tests.benchmarks.peers.adapters import ours
from tests.benchmarks.peers.scoring import score
from tests.benchmarks.peers.strip import Floats, Matrices, Strip, translations

SMALL: dict[str, dict[str, Any]] = {
    "array": {"cameras": 2, "width_px": 320, "height_px": 240, "px_per_mm": 12.0, "working_distance_mm": 300.0},
    "board": {"width_mm": 64.0, "length_mm": 76.0, "density": 6.0},
    "line": {"barrier_mm": -50.0, "tail_s": 1.0},
}
FRAME_PX = (320, 240)


@pytest.fixture(scope="module", params=["plain", "yaw", "line"])
def rendered(request: pytest.FixtureRequest) -> render_strips.RenderedStrip:
    variant = str(request.param)
    return render_strips.render_strip(variant, render_strips.twin_of(variant, **SMALL))


def shifted(true: Floats, by_px: Floats) -> Matrices:
    return [np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ m for m, (x, y) in zip(true, by_px, strict=True)]


@given(
    scale=st.floats(0.02, 50),
    angle=st.floats(-3.1, 3.1),
    shift=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
)
def test_scale_rotation_and_origin_of_a_mosaic_do_not_matter(
    scale: float, angle: float, shift: tuple[float, float]
) -> None:
    true = np.stack([m for m in translations(np.array([[0.0, 0], [280, 3], [1, 180]])) if m is not None])
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    own = np.array([[c, -s, shift[0]], [s, c, shift[1]], [0, 0, 1]])
    result = score([own @ m for m in true], true, FRAME_PX)
    assert result.rms_px == pytest.approx(0, abs=1e-6)


def test_errors_are_in_pixels_of_the_frames() -> None:
    """Eight frames far apart, each shifted by a pixel to the left or right: no similarity reduces these errors."""
    places = np.array([[x, y] for y in (0.0, 4000, 8000, 12000) for x in (0.0, 4000)])
    true = np.stack([m for m in translations(places) if m is not None])
    off = np.array([[1.0, 0], [-1, 0], [-1, 0], [1, 0]] * 2)
    result = score(shifted(true, off), true, FRAME_PX)
    assert result.rms_px == pytest.approx(1, rel=1e-3)
    assert result.max_px == pytest.approx(1, rel=1e-2)


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


def test_exception_of_a_peer_is_its_result(rendered: render_strips.RenderedStrip, tmp_path: Path) -> None:
    class Failing:
        PACKAGES: ClassVar[tuple[str, ...]] = ()
        SETTINGS: ClassVar[dict[str, Setting]] = {"a": Setting(), "b": Setting(strips=("another",))}

        @staticmethod
        def prepare(strip: Strip, directory: Path) -> Strip:
            return strip

        @staticmethod
        def place(strip: Strip) -> Matrices:
            raise LookupError("there is no good top pair")

    rendered.write(tmp_path)
    (run,) = place.run(Failing(), [tmp_path])
    assert run["failure"] == "LookupError: there is no good top pair"
    part = table.page_part([{"name": "ashlar", "versions": {"ashlar": "1"}, "machine": "m"} | run | {"strip": "plain"}])
    assert "gave up: LookupError: there is no good top pair" in part


def figures(name: str, setting: str, rms: float, *, dropped: int = 0, as_it_is: bool = True) -> table.Run:
    return {
        "name": name, "strip": "plain", "setting": setting, "as_it_is": as_it_is,
        "versions": {"numpy": "2"}, "machine": "m", "cpu_s": 1.0, "wall_s": 1.0, "repeats": 3,
        "dropped": dropped, "rms_px": None if dropped else rms, "max_px": None if dropped else 2 * rms,
    }  # fmt: skip


def test_best_setting_without_our_help_represents_a_stitcher() -> None:
    runs = [
        figures("nominal", "", 4.0),
        figures("stitching", "default", 0.0, dropped=10),
        figures("stitching", "SIFT", 0.25),
        figures("stitching", "with our help", 0.125, as_it_is=False),
        figures("ashlar", "default", 620.0),
    ]
    part = table.page_part(runs)
    assert "| `stitching` | 0.250 | 1.00 | not run" in part
    assert "| ASHLAR | failed | – | not run" in part
    assert "10 frames not placed" in part
    assert "wrong: worse than the nominal places" in part
    assert "620" not in part, "a failed run has no error in pixels"
    assert "0.125" in part


def test_new_run_replaces_the_old_one_and_the_page_is_updated(tmp_path: Path) -> None:
    runs = table.updated([figures("ours", "a", 0.5), figures("ashlar", "b", 0.02)], [figures("ours", "c", 0.25)])
    assert [(r["name"], r["rms_px"]) for r in runs] == [("ashlar", 0.02), ("ours", 0.25)]
    page = tmp_path / "peers.md"
    page.write_text(f"above\n{table.MARKERS[0]}\nold\n{table.MARKERS[1]}\nbelow\n")
    table.write_page(page, table.page_part(runs))
    text = page.read_text()
    assert text.startswith("above\n")
    assert text.endswith("below\n")
    assert "| this station | 0.250 | 1.00 |" in text
    assert "old" not in text
    page.write_text("no marks")
    with pytest.raises(ValueError, match="has no <!-- table -->"):
        table.write_page(page, "")


def test_page_agrees_with_the_stored_results() -> None:
    part = table.page_part(json.loads(table.RESULTS.read_text()))
    assert part in table.PAGE.read_text()
