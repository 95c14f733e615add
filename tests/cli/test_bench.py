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


def test_growth_is_measured_for_the_given_rows(vaoi: Any, tmp_path: Path) -> None:
    said = vaoi("bench", "--growth", "--rows", "4", "--json", tmp_path / "growth.json")
    assert (said.code, said.err) == (0, "")
    assert [b["frames"] for b in json.loads((tmp_path / "growth.json").read_text())["boards"]] == [12]
    assert "| 12 | 4 |" in said.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--station", "--growth"), "exclude each other"),
        (("--station", "--rates", "1,fast"), "--rates"),
        (("--growth", "--rows", "0"), "--rows"),
        (("--station", "--scenario", "nowhere"), "nowhere"),
    ],
)
def test_impossible_measurements_are_refused(vaoi: Any, arguments: tuple[str, ...], words: str) -> None:
    said = vaoi("bench", *arguments)
    assert said.code == 2
    assert words in said.err
