from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def test_figures_are_printed_and_kept(vaoi: Any, small_recording: Path, tmp_path: Path) -> None:
    said = vaoi("bench", "--case", small_recording, "--repetitions", 1, "--json", tmp_path / "bench.json")
    assert (said.code, said.err) == (0, "")
    figures = json.loads((tmp_path / "bench.json").read_text())
    for key in (
        "stitch_ms_per_frame",
        "paper_ms_per_frame",
        "ratio_to_paper_method",
        "ready_after_last_frame_ms",
        "images_per_s",
        "render_ratio_to_warp",
    ):
        assert figures[key] > 0
        assert f"{key:28s} {figures[key]}" in said.out
    assert figures["repetitions"] == 1
    assert (figures["cameras"], figures["rows"], figures["frame_px"]) == (2, 6, [640, 480])


def test_a_recording_that_is_not_there(vaoi: Any, tmp_path: Path) -> None:
    said = vaoi("bench", "--case", tmp_path / "nothing")
    assert said.code == 2
    assert "there is no such file" in said.err


def test_a_plot_is_of_marks(vaoi: Any, tmp_path: Path) -> None:
    said = vaoi("bench", "--plot", tmp_path / "curve.svg")
    assert said.code == 2
    assert "--plot belongs to --marks" in said.err
    assert not (tmp_path / "curve.svg").exists()
