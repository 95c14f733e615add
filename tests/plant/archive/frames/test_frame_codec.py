"""Every frame comes back bit for bit, and damage is noticed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.files.images import Image
from vaoi_station.plant.archive.frames import decode_frame, encode_frame

CHANCE = np.random.default_rng(7)


def scene(bits: int, shape: tuple[int, ...] = (61, 83)) -> Image:
    """Return a picture with edges and noise that uses all values of `bits` bits."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    top = (1 << bits) - 1
    picture = (np.sin(x / 9) + (y > 30)) * top / 3 + CHANCE.normal(0, top / 60, shape[:2])
    picture[0, 7:9] = 0, top
    scene: Image = np.clip(picture, 0, top).astype(np.uint8 if bits == 8 else np.uint16)
    return scene


def bayer(bits: int) -> Image:
    """Return a picture in which neighbouring pixels have filters of different colours."""
    picture = scene(bits).astype(np.float64)
    picture[::2, ::2] *= 0.4
    picture[1::2, 1::2] *= 0.7
    return picture.astype(np.uint8 if bits == 8 else np.uint16)


PICTURES = {
    "8 bit": scene(8),
    "10 bit": scene(10),
    "12 bit": scene(12),
    "16 bit": scene(16),
    "12 bit at full scale": (scene(12) << 4) | (scene(12) >> 8),
    "Bayer 8": bayer(8),
    "Bayer 12": bayer(12),
    "colour": np.stack([scene(8), scene(8) // 2, 255 - scene(8)], -1),
    "colour 16": np.stack([scene(16), scene(12), scene(16)[::-1]], -1),
    "extremes": CHANCE.choice(np.array([0, 65535], np.uint16), (33, 47)),
    "chance": CHANCE.integers(0, 65536, (40, 50)).astype(np.uint16),
    "one value": np.full((17, 16), 200, np.uint8),
    "black": np.zeros((16, 16), np.uint16),
    "one row": scene(8, (1, 40)),
    "one pixel": np.array([[7]], np.uint8),
    "odd rows of Bayer": bayer(8)[:5, :7],
    "every other column": scene(8)[:, ::2],
    "rough only in few places": np.pad(scene(16, (9, 9)), ((90, 200), (120, 3))),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_comes_back_bit_for_bit(name: str) -> None:
    picture = PICTURES[name]
    stored = encode_frame(picture)
    back = decode_frame(stored)
    assert (back.dtype, back.shape) == (picture.dtype, picture.shape)
    assert np.array_equal(back, picture)
    assert encode_frame(back) == stored


def test_values_that_do_not_occur_cost_nothing() -> None:
    """A camera of 12 bits may deliver its values scaled to 16."""
    plain, scaled = PICTURES["12 bit"], (PICTURES["12 bit"] << 4) | (PICTURES["12 bit"] >> 8)
    assert len(encode_frame(scaled)) < 1.1 * len(encode_frame(plain))


def test_neighbours_of_a_mosaic_are_of_one_colour() -> None:
    mosaic = bayer(8)
    assert len(encode_frame(mosaic)) < 1.15 * len(encode_frame(scene(8)))


def test_noise_costs_little_more_than_its_entropy() -> None:
    noise = np.rint(CHANCE.normal(128, 2, (256, 256))).astype(np.uint8)
    entropy_bits = math.log2(2 * math.sqrt(2 * math.pi * math.e))
    assert 8 * len(encode_frame(noise)) / noise.size < entropy_bits + 0.32


@pytest.mark.parametrize("name", ["8 bit", "Bayer 12", "12 bit at full scale", "colour"])
def test_damage_is_noticed(name: str) -> None:
    stored = encode_frame(PICTURES[name])
    for at in CHANCE.integers(0, len(stored), 60):
        damaged = bytearray(stored)
        damaged[at] ^= 1 << int(CHANCE.integers(8))
        try:
            same = np.array_equal(decode_frame(bytes(damaged)), PICTURES[name])
        except ValueError:
            continue
        # What fills up the last byte of a strip, or belongs to a kind that does not occur, is not read.
        assert same
    for end in CHANCE.integers(0, len(stored), 10):
        with pytest.raises(ValueError):  # noqa: PT011  the texts differ by the part that is cut
            decode_frame(stored[:end])


def test_a_newer_frame_is_named() -> None:
    with pytest.raises(ValueError, match="version 4, this software reads 3"):
        decode_frame(b"VFR4" + encode_frame(PICTURES["black"])[4:])
