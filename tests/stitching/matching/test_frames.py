"""Tests of the frames of a run: what was doubtful when they were taken reaches the verdict."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import Status
from vaoi_station.stitching.matching.frames import PreparedFrame, resample
from vaoi_station.stitching.work import stitch_frames


def test_copies_keep_positions(workshop: Any) -> None:
    """The centre of pixel k of a copy lies at (k + ½)·factor − ½: a soft dot is found there in each."""
    at = np.array([331.0, 205.0])
    y, x = np.mgrid[:480, :640].astype(float)
    dot = workshop.digitised(20 + 200 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * 12**2)))
    frame = PreparedFrame(dot)
    assert frame.factor == 4
    for copy, factor in ((frame.grey, 1), (frame.reduced(4), 4), (frame.reduced(2), 2), (frame.reduced(8), 8)):
        weight = copy.astype(float) - 20
        v, u = np.mgrid[: copy.shape[0], : copy.shape[1]]
        found = np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()
        assert (found + 0.5) * factor - 0.5 == pytest.approx(at, abs=0.3)


@pytest.mark.parametrize(("width", "factor"), [(640, 4), (1392, 8), (2400, 16), (300, 4), (200, 4)])
def test_the_coarse_copy_is_at_least_150_pixels_wide(width: int, factor: int) -> None:
    frame = PreparedFrame(np.zeros((96, width), dtype=np.uint8))
    assert frame.factor == factor
    assert frame.coarse.shape == (96 // factor, width // factor)


def test_quarter_size_has_the_means_of_blocks() -> None:
    image = np.random.default_rng(0).integers(0, 256, (43, 59), dtype=np.uint8)
    means = image[:40, :56].reshape(10, 4, 14, 4).mean((1, 3))
    np.testing.assert_array_equal(PreparedFrame(image).reduced(4), np.floor(means + 0.5))


@pytest.mark.parametrize("wide", [1.0, 1.4, 2.5])
@pytest.mark.parametrize("angle", [0.0, 0.2, 1.6, 3.1])
def test_a_resampled_frame_shows_the_same_content(workshop: Any, wide: float, angle: float) -> None:
    waves = workshop.waves(2, finest=12.0, coarsest=40.0)
    linear = wide * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = np.column_stack([linear, np.array([159.7, 120.2]) - linear @ (30.0, 25.0)])
    frame = workshop.digitised(waves.levels(320, 240))
    part = resample(frame, affine, (60, 50), wide)
    at = np.stack(np.meshgrid(np.arange(60.0), np.arange(50.0)), -1) @ linear.T + affine[:, 2]
    inside = ((at > 10) & (at < (309, 229))).all(-1)
    exact = waves(at[..., 0], at[..., 1])[inside]
    assert np.abs(part[inside] - exact).max() < 1.5
    assert abs((part[inside] - exact).mean()) < 0.05


def test_outside_its_part_a_masked_frame_is_without_texture(workshop: Any) -> None:
    whole = PreparedFrame(workshop.digitised(workshop.waves(1, finest=12.0, coarsest=40.0).levels(640, 480)))
    left = whole.masked(np.array([(0.0, 0.0), (319.5, 0.0), (319.5, 479.0), (0.0, 479.0)]))
    assert left.grey is whole.grey
    assert left.factor == whole.factor
    middle = whole.coarse.shape[1] // 2
    np.testing.assert_array_equal(left.coarse[:, : middle - 1], whole.coarse[:, : middle - 1])
    assert not left.coarse[:, middle + 1 :].any()
    assert left.reduced(8) is whole.reduced(8)


DOUBT = "trigger of camera 1: it runs freely; these frames are not used"


def test_a_doubt_of_the_recording_is_the_first_reason_of_its_result(filmed: Any) -> None:
    """The same run without the doubt is ok."""
    assert filmed.stitch.status is Status.OK
    doubted = filmed.head.model_copy(update={"doubts": (DOUBT,)})
    stitch = stitch_frames(filmed.setup, doubted, filmed.frame)
    assert stitch.status is Status.DEGRADED
    assert stitch.reasons == (DOUBT,)


def test_without_any_usable_frame_the_doubts_explain_the_failure(filmed: Any) -> None:
    everything = tuple((i, j) for i in range(len(filmed.head.cameras)) for j in range(filmed.head.rows))
    head = filmed.head.model_copy(update={"doubts": (DOUBT,), "missing": everything})
    stitch = stitch_frames(filmed.setup, head, lambda *_: None)
    assert stitch.status is Status.FAILED
    assert DOUBT in stitch.reasons
