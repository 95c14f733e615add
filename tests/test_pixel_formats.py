"""Every pixel format against an independent bit-by-bit reference of the convention."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.pixel_formats import PIXEL_FORMATS, PixelFormat, eight_bit_grey, picture, samples, to_full_scale

FORMATS = st.sampled_from(list(PIXEL_FORMATS.values()))
SIZES = st.tuples(st.integers(1, 9), st.integers(1, 7))


def packed(values: list[int], pixel_format: PixelFormat) -> bytes:
    """Return the bytes that a camera sends, built as one long number, independent of the tested code."""
    bits = pixel_format.bits
    if pixel_format.packing == "packed":  # two samples in three bytes: high A, low B | low A, high B
        text = bytearray()
        for k in range(0, len(values), 2):
            a, b = values[k], values[k + 1] if k + 1 < len(values) else 0
            low = bits - 8
            text += bytes([a >> low, (b % 2**low) << 4 | a % 2**low, b >> low])
        return bytes(text[: pixel_format.nbytes(len(values), 1)])
    step = {"bytes": 8, "words": 16, "p": bits}[pixel_format.packing]
    number = sum(value << k * step for k, value in enumerate(values))
    return number.to_bytes(pixel_format.nbytes(len(values), 1), "little")


@given(FORMATS, SIZES, st.data())
def test_samples_are_unpacked_without_loss(
    pixel_format: PixelFormat, size: tuple[int, int], data: st.DataObject
) -> None:
    width, height = size
    count = width * height
    values = data.draw(st.lists(st.integers(0, 2**pixel_format.bits - 1), min_size=count, max_size=count))
    frame = np.frombuffer(packed(values, pixel_format), np.uint8)
    assert len(frame) == pixel_format.nbytes(width, height)
    assert samples(frame, count, pixel_format).tolist() == values
    if not pixel_format.mosaic:
        seen = picture(frame, width, height, pixel_format)
        assert seen.shape == (height, width)
        top = 255 if pixel_format.bits == 8 else 65535
        exact = np.array(values) * top / (2**pixel_format.bits - 1)
        assert np.abs(seen.ravel() - exact).max() < 1
        assert (seen.ravel() >> (top.bit_length() - pixel_format.bits)).tolist() == values, "nothing is lost"


@pytest.mark.parametrize("name", [name for name, known in PIXEL_FORMATS.items() if not known.in_place])
def test_other_formats_do_not_change_the_frame(name: str) -> None:
    frame = np.random.default_rng(1).integers(0, 256, PIXEL_FORMATS[name].nbytes(6, 4), dtype=np.uint8)
    before = frame.copy()
    frame.flags.writeable = False
    seen = picture(frame, 6, 4, PIXEL_FORMATS[name])
    seen += 1
    assert (frame == before).all()


@pytest.mark.parametrize("name", [name for name, known in PIXEL_FORMATS.items() if known.mosaic])
def test_a_red_scene_under_a_bayer_filter_is_red(name: str) -> None:
    """Only pixels behind red filters are bright; the name gives their positions: RG is red, green in the first row."""
    pixel_format = PIXEL_FORMATS[name]
    first = {"RG": (0, 0), "GR": (0, 1), "GB": (1, 0), "BG": (1, 1)}[pixel_format.mosaic]
    white = 2**pixel_format.bits - 1
    mosaic = np.zeros((8, 12), int)
    mosaic[first[0] :: 2, first[1] :: 2] = white
    frame = np.frombuffer(packed(mosaic.ravel().tolist(), pixel_format), np.uint8)
    seen = picture(frame, 12, 8, pixel_format)
    assert seen.shape == (8, 12, 3)
    full = 65535 if pixel_format.bits > 8 else 255
    assert (seen[2:-2, 2:-2] == (0, 0, full)).all()


@given(st.sampled_from([10, 12, 14, 16]), st.integers(1, 255), st.integers(0, 1000))
def test_pictures_of_more_bits_have_the_scale_of_their_bits(bits: int, top: int, seed: int) -> None:
    """However dark a picture is, it is not brightened."""
    eight = np.random.default_rng(seed).integers(0, top, (20, 30), endpoint=True).astype(np.uint16)
    full = to_full_scale(eight << (bits - 8), bits)
    assert np.array_equal(eight_bit_grey(full), eight.astype(np.uint8))


def test_colour_becomes_luminance_and_grey_stays() -> None:
    colour = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    assert np.array_equal(eight_bit_grey(colour), cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY))
    assert eight_bit_grey(colour[..., 0]).base is colour
