from __future__ import annotations

import io

import cv2
import numpy as np
import pytest

from vaoi_station.hdr.encoding import MergedFormat, encode_merged, tone_map

VALUE = np.array([[0.5, np.nan], [2.0, 8.0]], np.float32)


def test_linear_formats_keep_every_value() -> None:
    np.testing.assert_array_equal(np.load(io.BytesIO(encode_merged(VALUE, "npy"))), VALUE)
    tiff = cv2.imdecode(np.frombuffer(encode_merged(VALUE, "tiff"), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(tiff, VALUE)


@pytest.mark.parametrize("form", ["png", "jpeg"])
def test_formats_for_people_have_8_bits(form: MergedFormat) -> None:
    shown = cv2.imdecode(np.frombuffer(encode_merged(VALUE, form), np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert shown.dtype == np.uint8
    assert shown.shape == (2, 2)


def test_bright_places_are_bright_and_dark_ones_differ() -> None:
    value = np.repeat(np.logspace(-1, 1.4, 240, dtype=np.float32)[None], 20, 0)
    shown = tone_map(value)
    assert shown.dtype == np.uint8
    assert (np.diff(shown[0].astype(int)) >= 0).all()
    assert shown[0, -1] == 255
    assert 80 < np.median(shown) < 140
    assert shown[0, 60] - shown[0, 0] > 8


def test_places_without_a_value_are_black() -> None:
    value = np.array([[1.0, np.nan, 2.0, -0.1]], np.float32)
    shown = tone_map(value)
    assert (shown[0, 1], shown[0, 3]) == (0, 0)
    assert not tone_map(np.full((3, 3), np.nan, np.float32)).any()
    assert not tone_map(np.zeros((3, 3), np.float32)).any()
