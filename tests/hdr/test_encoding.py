from __future__ import annotations

import io

import cv2
import numpy as np
import pytest

from vaoi_station.hdr.encoding import MergedFormat, encode_merged

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
