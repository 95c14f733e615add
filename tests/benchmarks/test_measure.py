from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vaoi_station.benchmarks.frames import Material, of_recording, of_twin
from vaoi_station.benchmarks.measure import Figures, measure
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage

ISSUED = {"stitch_ms_per_frame", "ratio_to_paper_method", "ready_after_last_frame_ms", "render_ratio_to_warp"}


@pytest.fixture(scope="module")
def material() -> Material:
    return of_twin("small")


@pytest.fixture(scope="module")
def figures(material: Material) -> Figures:
    return measure(material, repetitions=1)


def test_every_figure_is_there_and_finite(figures: Figures) -> None:
    document = figures.document()
    assert document.keys() >= ISSUED | {"paper_ms_per_frame", "images_per_s", "repetitions", "status", "opencv"}
    for key in ISSUED | {"paper_ms_per_frame", "images_per_s"}:
        assert np.isfinite(document[key]), key
        assert document[key] > 0, key
    assert (figures.status, figures.paper_failed) == ("ok", "")
    assert (figures.cameras, figures.rows, figures.frame_px) == (2, 6, (640, 480))
    low, high = figures.stitch_spread_ms
    assert low <= figures.stitch_ms_per_frame <= high


def test_the_ratio_is_that_of_the_milliseconds(figures: Figures) -> None:
    ratio = figures.paper_ms_per_frame / figures.stitch_ms_per_frame
    assert figures.ratio_to_paper_method == pytest.approx(ratio, rel=0.02)


def test_threads_are_given_back_whatever_happens(material: Material, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(material: Material, repetitions: int) -> Figures:
        assert cv2.getNumThreads() == 1
        raise ZeroDivisionError

    monkeypatch.setattr("vaoi_station.benchmarks.measure._measure", fails)
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    with pytest.raises(ZeroDivisionError):
        measure(material)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(before)
    assert threads == 2


def test_a_recording_is_the_same_material(tmp_path: Path, material: Material) -> None:
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), tmp_path)
    read = of_recording(tmp_path)
    assert read.truth is None, "a truth beside a recording is never looked at"
    assert read.frames.keys() == material.frames.keys()
    assert all(np.array_equal(read.frames[key], material.frames[key]) for key in material.frames)
    assert read.head.row_times_s() == pytest.approx(material.head.row_times_s())
