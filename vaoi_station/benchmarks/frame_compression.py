"""Ratio and CPU time of lossless compressions of frames, each checked bit for bit: `vaoi bench --archive`."""

from __future__ import annotations

import importlib
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, InternalError
from vaoi_station.files import open_recording
from vaoi_station.files.images import Image, decode, encode_png, read_image
from vaoi_station.plant.archive.frames import decode_frame, encode_frame

_PER_RECORDING = 2
"""Number of frames that are taken of each recording."""
_REPEATS = 5
"""Number of times that each frame is encoded and decoded.

The least time is the method's own, because other work only adds to it; the median says how much it adds.
"""


class Method(NamedTuple):
    """One compression."""

    name: str
    encode: Callable[[Image], bytes]
    decode: Callable[[bytes, Image], Image]
    """Returns the frame; the frame that was encoded is given for its shape and type."""


@dataclass
class MethodFigures:
    """What one method made of all frames."""

    name: str
    stored_bytes: int = 0
    """Of all repetitions."""
    encode_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    """Sums over all frames of the least and of the median time."""
    decode_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True)
class CompressionFigures:
    """What all methods made of the same frames."""

    frames: int
    pixels: int
    raw_bytes: int
    methods: tuple[MethodFigures, ...]
    absent: tuple[str, ...]
    """Libraries that would provide further methods, and are not installed."""

    def document(self) -> dict[str, Any]:
        """Return the figures as a JSON object; times are CPU times in ns per pixel."""
        return {
            "frames": self.frames,
            "pixels": self.pixels,
            "absent": list(self.absent),
            "methods": {
                one.name: {
                    "ratio": round(_REPEATS * self.raw_bytes / one.stored_bytes, 3),
                    "bits_per_pixel": round(8 * one.stored_bytes / (_REPEATS * self.pixels), 3),
                    "encode_ns_per_pixel": round(1e9 * one.encode_s[0] / self.pixels, 2),
                    "encode_median_ns": round(1e9 * one.encode_s[1] / self.pixels, 2),
                    "decode_ns_per_pixel": round(1e9 * one.decode_s[0] / self.pixels, 2),
                    "decode_median_ns": round(1e9 * one.decode_s[1] / self.pixels, 2),
                }
                for one in self.methods
            },
        }

    def lines(self) -> Iterator[str]:
        """Yield a table in Markdown."""
        yield f"{self.frames} frames, {self.pixels / 1e6:.1f} Mpx; CPU time of one thread, {_REPEATS} times."
        yield ""
        yield "| method | ratio | bits per pixel | encode, ns per pixel: least | median | decode: least | median |"
        yield "|---|---|---|---|---|---|---|"
        for name, row in self.document()["methods"].items():
            yield f"| {name} | " + " | ".join(str(value) for value in row.values()) + " |"
        for library in self.absent:
            yield f"Not installed: {library}."


def measure_compression(folder: Path) -> CompressionFigures:
    """Compress frames of a recording, or of all recordings in a directory, by every method that is installed.

    Raises:
        InputError: there is no recording.
        InternalError: a method did not return a frame as it was.
    """
    frames = list(_frames(folder))
    if not frames:
        raise InputError(f"{folder}: is no recording and has none.", action="Give the directory of a recording.")
    methods = [*_own_methods()]
    absent = []
    for library, further in _FURTHER.items():
        try:
            methods += further(importlib.import_module(library))
        except ImportError:
            absent.append(library)
    figures = _measure(methods, frames)
    pixels, raw = (sum(getattr(frame, key) for frame in frames) for key in ("size", "nbytes"))
    return CompressionFigures(len(frames), pixels, raw, figures, tuple(absent))


def _frames(folder: Path) -> Iterator[Image]:
    heads = sorted(folder.glob("*/recording.json")) if folder.is_dir() else []
    for head in [folder / "recording.json"] if (folder / "recording.json").is_file() else heads:
        recording = open_recording(head.parent)
        keys = [(i, j) for i in range(len(recording.head.cameras)) for j in range(recording.head.rows)]
        paths = [path for key in keys if (path := recording.frame_path(*key)) is not None]
        for k in np.linspace(0, len(paths) - 1, min(_PER_RECORDING, len(paths))).astype(int):
            yield read_image(paths[k])


def _measure(methods: Sequence[Method], frames: Sequence[Image]) -> tuple[MethodFigures, ...]:
    """Let the methods take turns with each frame, because the speed of a machine changes within seconds."""
    figures = tuple(MethodFigures(method.name) for method in methods)
    for method in methods:
        method.decode(method.encode(frames[0]), frames[0])  # compiles, and loads libraries
    for frame in frames:
        for method, one in zip(methods, figures, strict=True):
            times_s = np.array([_once(method, frame, one) for _ in range(_REPEATS)])
            least_s, median_s = times_s.min(0), np.median(times_s, axis=0)
            one.encode_s += least_s[0], median_s[0]
            one.decode_s += least_s[1], median_s[1]
    return figures


def _once(method: Method, frame: Image, figures: MethodFigures) -> tuple[float, float]:
    """Return the times to encode and to decode a frame."""
    start_s = time.thread_time()
    stored = method.encode(frame)
    between_s = time.thread_time()
    back = method.decode(stored, frame)
    end_s = time.thread_time()
    if back.dtype != frame.dtype or not np.array_equal(back, frame):
        raise InternalError(f"{method.name} did not return a frame as it was.")
    figures.stored_bytes += len(stored)
    return between_s - start_s, end_s - between_s


def _own_methods() -> Iterator[Method]:
    yield Method("of the archive", encode_frame, lambda stored, _: decode_frame(stored))
    for level in (1, 3, 6):
        yield Method(f"PNG, level {level}", lambda frame, level=level: encode_png(frame, level), _decode_picture)  # type: ignore[misc]
    yield Method("zlib 1 of differences", lambda frame: zlib.compress(_differences(frame), 1), _undo_zlib)


def _decode_picture(stored: bytes, _: Image) -> Image:
    image = decode(stored)
    if image is None:
        raise InternalError("OpenCV cannot read what it has written.")
    return image


def _differences(frame: Image) -> bytes:
    """Return each pixel minus the one above it: a predictor that numpy undoes by one sum."""
    return np.diff(frame, axis=0, prepend=np.zeros_like(frame[:1])).tobytes()


def _sums(content: bytes, frame: Image) -> Image:
    return np.cumsum(np.frombuffer(content, frame.dtype).reshape(frame.shape), axis=0, dtype=frame.dtype)


def _undo_zlib(stored: bytes, frame: Image) -> Image:
    return _sums(zlib.decompress(stored), frame)


def _of_imagecodecs(library: Any) -> list[Method]:
    return [
        Method("JPEG-LS (CharLS)", library.jpegls_encode, lambda stored, _: library.jpegls_decode(stored)),
        *(
            Method(
                f"JPEG XL lossless, effort {effort}",
                lambda frame, effort=effort: library.jpegxl_encode(frame, lossless=True, effort=effort, numthreads=1),  # type: ignore[misc]
                lambda stored, _: library.jpegxl_decode(stored, numthreads=1),
            )
            for effort in (1, 3)
        ),
    ]


def _of_zstandard(library: Any) -> list[Method]:
    return [
        Method(
            f"zstd {level} of differences",
            lambda frame, level=level: library.ZstdCompressor(level).compress(_differences(frame)),  # type: ignore[misc]
            lambda stored, frame: _sums(library.ZstdDecompressor().decompress(stored), frame),
        )
        for level in (1, 9)
    ]


_FURTHER: dict[str, Callable[[Any], list[Method]]] = {"imagecodecs": _of_imagecodecs, "zstandard": _of_zstandard}
