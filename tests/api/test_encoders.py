"""Choice of the image format, and the encoded pictures."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vaoi_station.api.encoders import MEDIA_TYPES, ImageFormat, choose_format, encode_image
from vaoi_station.api.problems import NotAcceptableError

SHAPES = st.one_of(st.tuples(*[st.integers(1, 12)] * 2), st.tuples(*[st.integers(1, 12)] * 2, st.just(3)))
IMAGES = st.sampled_from([np.uint8, np.uint16]).flatmap(lambda kind: arrays(kind, SHAPES))
EXACT = [ImageFormat.PNG, ImageFormat.TIFF, ImageFormat.NPY, ImageFormat.RAW]


@pytest.mark.parametrize(
    ("asked", "accept", "expected"),
    [
        (None, None, "png"),
        (None, "*/*", "png"),
        (None, "image/*", "png"),
        (None, "image/jpeg", "jpeg"),
        (None, "text/html, image/tiff;q=0.5, image/jpeg;q=0.8", "jpeg"),
        (None, "image/png;q=0, */*", "jpeg"),
        (None, "image/*;q=0.5, application/x-npy", "npy"),
        (None, "application/octet-stream", "raw"),
        (None, "IMAGE/PNG", "png"),
        (None, "application/problem+json", "png"),
        (None, "application/problem+json;q=0.5, image/jpeg", "jpeg"),
        ("jpg", None, "jpeg"),
        ("RAW", "image/png", "raw"),
        ("tif", "text/html", "tiff"),
    ],
)
def test_query_and_accept_choose_the_format(asked: str | None, accept: str | None, expected: str) -> None:
    assert choose_format(asked, accept) == expected


@pytest.mark.parametrize(("asked", "accept"), [("bmp", None), ("", None), (None, "text/html"), (None, "image/png;q=x")])
def test_unavailable_formats_are_refused_with_the_available_ones(asked: str | None, accept: str | None) -> None:
    with pytest.raises(NotAcceptableError) as refusal:
        choose_format(asked, accept)
    offer = list(ImageFormat) if accept is None else MEDIA_TYPES.values()
    assert all(str(name) in refusal.value.message for name in offer)


def decoded(content: bytes) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED))


@given(image=IMAGES, image_format=st.sampled_from(EXACT))
def test_lossless_formats_keep_every_pixel(image: np.ndarray, image_format: ImageFormat) -> None:
    content, headers = encode_image(image, image_format)
    red_first = image if image.ndim == 2 else image[..., ::-1]
    found: np.ndarray
    if image_format is ImageFormat.RAW:
        dtype = np.dtype(headers["X-Image-Dtype"]).newbyteorder("<")
        found = np.frombuffer(content, dtype).reshape(image.shape)
        assert int(headers["X-Image-Stride"]) * int(headers["X-Image-Height"]) == len(content)
    elif image_format is ImageFormat.NPY:
        found = np.load(io.BytesIO(content))
    else:
        found, red_first = decoded(content), image
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, red_first)
