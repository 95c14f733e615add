"""Read and write image files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vaoi_station.errors import DeviceError, GoneError, InputError
from vaoi_station.files.images import (
    decode,
    encode,
    encode_png,
    read_image,
    read_kept_image,
    write_image,
)

g = np.random.default_rng(1)


@pytest.mark.parametrize(
    "image",
    [
        g.integers(0, 256, (20, 30), dtype=np.uint8),
        g.integers(0, 65536, (20, 30), dtype=np.uint16),
        g.integers(0, 256, (20, 30, 3), dtype=np.uint8),
        g.integers(0, 65536, (20, 30, 3), dtype=np.uint16),
    ],
    ids=["grey-8", "grey-16", "colour-8", "colour-16"],
)
@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_frames_round_trip(tmp_path: Path, image: np.ndarray, suffix: str) -> None:
    path = tmp_path / f"c00_r000{suffix}"
    write_image(path, image) if suffix == ".png" else path.write_bytes(encode(suffix, image, []))
    found = read_image(path)
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_fastest_png_of_a_noisy_picture_is_no_larger_than_that_of_a_level(dtype: type) -> None:
    slope = np.add.outer(np.arange(200), np.arange(300)) / 500 * np.iinfo(dtype).max
    image: np.ndarray = np.clip(g.normal(slope, 0.01 * np.iinfo(dtype).max), 0, np.iinfo(dtype).max).astype(dtype)
    fastest = encode_png(image)
    np.testing.assert_array_equal(decode(fastest), image)
    assert len(fastest) <= len(encode_png(image, 1))


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
@pytest.mark.parametrize("part", [0.0, 0.01, 0.5, 0.99])
def test_incomplete_frame_is_refused_by_one_message(
    tmp_path: Path, part: float, suffix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """The image libraries write nothing to stderr themselves."""
    content = encode(suffix, g.integers(0, 256, (64, 64), dtype=np.uint8), [])
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(InputError, match=rf"cut{suffix}: is not a picture"):
        read_image(path)
    assert capfd.readouterr().err == ""


def test_flipped_byte_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content = bytearray(encode_png(g.integers(0, 256, (64, 64), dtype=np.uint8)))
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "bad.png").write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.png"):
        read_image(tmp_path / "bad.png")
    assert capfd.readouterr().err == ""


def test_transparency_and_floats_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", np.zeros((20, 20, 4), np.uint8))[1].tobytes())
    with pytest.raises(InputError, match=r"a\.png: number of channels is 4, but must be 1"):
        read_image(tmp_path / "a.png")
    (tmp_path / "f.tiff").write_bytes(cv2.imencode(".tiff", np.zeros((20, 20), np.float32))[1].tobytes())
    with pytest.raises(InputError, match=r"f\.tiff: pixel type is 'float32', but must be 8 or 16 bit"):
        read_image(tmp_path / "f.tiff")


@pytest.mark.parametrize("suffix", [".webp", ".bmp", ".ppm", ".hdr"])
def test_other_formats_are_refused_whatever_their_name_is(tmp_path: Path, suffix: str) -> None:
    """OpenCV decides by content: a run archive of another origin would reach the decoders of all its formats."""
    grey = np.zeros((8, 8, 3), np.float32 if suffix == ".hdr" else np.uint8)
    (tmp_path / "frame.png").write_bytes(cv2.imencode(suffix, grey)[1].tobytes())
    with pytest.raises(InputError, match="not a picture"):
        read_image(tmp_path / "frame.png")


def test_a_kept_frame_that_is_gone_or_damaged_is_not_the_callers_fault(tmp_path: Path) -> None:
    path = tmp_path / "frame.tiff"
    with pytest.raises(GoneError, match="the recording was deleted"):
        read_kept_image(path)
    path.write_bytes(b"II*\0")
    with pytest.raises(DeviceError, match="is not a picture"):
        read_kept_image(path)
    write_image(path, np.full((3, 4), 7, np.uint8))
    assert read_kept_image(path).shape == (3, 4)
