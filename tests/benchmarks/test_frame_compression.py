"""The comparison of compressions counts what was stored, and checks every frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.benchmarks.benchmark_board import BenchmarkBoard
from vaoi_station.benchmarks.frame_compression import measure_compression
from vaoi_station.errors import InputError
from vaoi_station.files import write_recording


def test_methods_are_compared_on_the_same_frames(small_board: BenchmarkBoard, tmp_path: Path) -> None:
    write_recording(tmp_path, small_board.head, ((*at, frame) for at, frame in small_board.frames.items()))
    figures = measure_compression(tmp_path)
    assert (figures.frames, figures.pixels) == (2, 2 * small_board.frames[0, 0].size)
    methods = figures.document()["methods"]
    assert methods["of the archive"]["ratio"] > methods["PNG, level 3"]["ratio"] > 1
    assert f"| of the archive | {methods['of the archive']['ratio']} |" in "\n".join(figures.lines())


def test_a_directory_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no recording and has none"):
        measure_compression(tmp_path)
