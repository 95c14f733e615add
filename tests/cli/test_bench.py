from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.benchmarks import station_pace
from vaoi_station.benchmarks.station_pace import PrerenderedRun, RateFigures


def test_figures_are_printed_and_written(vaoi: Any, small_recording: Path, tmp_path: Path) -> None:
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
        "hdr_ratio_to_plain",
        "heights_ms",
    ):
        assert figures[key] > 0
        assert f"{key:28s} {figures[key]}" in said.out
    assert figures["repetitions"] == 1
    assert (figures["cameras"], figures["rows"], figures["frame_px"]) == (2, 6, [640, 480])


def test_station_is_measured_at_every_rate(vaoi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One station runs; the figures of the second rate repeat those of the first."""
    real, measured = station_pace.measure_station_pace, list[RateFigures]()

    def measure(board: PrerenderedRun, rate: float, *rest: Any) -> RateFigures:
        measured.append(replace(measured[0], rate=rate) if measured else real(board, rate, *rest))
        return measured[-1]

    monkeypatch.setattr(station_pace, "measure_station_pace", measure)
    options = ("--scenario", "small", "--rates", "1,3", "--boards", 1, "--films", tmp_path, "--ring", tmp_path)
    said = vaoi("bench", "--station", *options, "--json", tmp_path / "station.json")
    assert (said.code, said.err) == (0, "")
    document = json.loads((tmp_path / "station.json").read_text())
    assert [r["rate"] for r in document["rates"]] == [1, 3]
    assert all(r["boards"] == 1 and r["frames_lost"] == 0 for r in document["rates"])
    assert "| 3× |" in said.out
    assert list((tmp_path / "small").glob("*/frames.raw")), "kept for the next time"


def test_profile_shows_tasks_stages_and_functions(vaoi: Any, small_recording: Path, tmp_path: Path) -> None:
    options = "--case", small_recording, "--repetitions", 1, "--json", tmp_path / "profile.json"
    said = vaoi("bench", "--profile", *options)
    assert (said.code, said.err) == (0, "")
    document = json.loads((tmp_path / "profile.json").read_text())
    assert set(document["kinds_ms"]) == {"rows", "neighbours", "marks", "prepare"}
    assert set(document["stages_ms"]) >= {"motion", "cad", "verdict"}
    names = {name for name, *_ in document["functions"]["rows, per frame"]}
    assert {"stitching/matching/link: find_shift", "stitching/matching/patches: match_patches"} <= names
    assert all(0 <= own_ms <= ms for part in document["functions"].values() for *_, ms, own_ms in part)
    assert "| conclusion |" in said.out


def test_compile_times_are_those_of_a_new_process(vaoi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new process stitches nothing here, because it would compile for a minute."""
    printed = (
        "def stitch_board(_):\n    from vaoi_station.marks.template_correlation import correlate_with_shape as f\n"
    )
    printed += "    import numpy as np\n    f(np.zeros((9, 9), np.uint8), 4.0, 4.0, 0, 4.0, 0.25, 6.0)\n"
    program = f"from vaoi_station.benchmarks import profile\n{printed}profile.stitch_board = stitch_board\n"
    program += "profile.board_from_twin = str\nprofile.print_compiling({scenario!r})"
    monkeypatch.setattr("vaoi_station.benchmarks.profile._PROGRAM", program)
    said = vaoi("bench", "--profile", "--compile")
    assert (said.code, said.err) == (0, "")
    assert "| marks.template_correlation: correlate_with_shape | 1 |" in said.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--station", "--profile"), "exclude each other"),
        (("--station", "--rates", "1,fast"), "--rates"),
        (("--station", "--scenario", "nowhere"), "nowhere"),
    ],
)
def test_impossible_measurements_are_refused(vaoi: Any, arguments: tuple[str, ...], words: str) -> None:
    said = vaoi("bench", *arguments)
    assert said.code == 2
    assert words in said.err
