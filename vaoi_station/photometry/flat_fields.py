"""Flat fields of a camera array: one per camera and light, read from the directory that `vaoi flatfield` writes.

A directory holds `flatfield.json` and pictures of 32-bit floats, TIFF, in `fields/`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from vaoi_station.errors import InputError, VaoiError
from vaoi_station.files.documents import check_format, parse, read_json, write_bytes, write_json
from vaoi_station.files.images import decode, encode_tiff
from vaoi_station.model import CameraHead, Finite, FrozenModel, Positive, RecordingHead, Whole
from vaoi_station.photometry.noise import Floats32, NoiseModel

DOCUMENT = "flatfield.json"
EXPIRED_DAYS = 180
"""Age of flat fields, in days, from which a new measurement is due: lamps age, and dust settles on lenses."""
_MAKE = "Make flat fields of this array with 'vaoi flatfield'."
_LARGEST = 1e3
"""Largest value of a flat field; one of a real lens is below 3."""
_LEAST_CHANNEL = 0.125
"""Least share of the strongest channel that the weakest one has under white light.

Sensors and warm white lamps stay above 0.25. Under a coloured lamp it is below 0.1, and nothing there can be white.
"""

Side = Annotated[Whole, Field(ge=16, le=65536)]
Share = Annotated[Finite, Field(ge=0, le=100)]
FileName = Annotated[str, Field(pattern=r"^fields/[A-Za-z0-9._-]+\.tiff$", max_length=200)]


class CameraFields(FrozenModel):
    """Size, dark level and noise of one camera, in 8-bit grey levels."""

    width: Side
    """Width of its frames, px."""
    height: Side
    """Height of its frames, px."""
    dark: Annotated[Finite, Field(ge=0, le=255)] = 0.0
    """Grey level of darkness, mean over the frame."""
    dark_file: FileName | None = None
    """Picture of the dark level, where it differs from pixel to pixel."""
    read: Annotated[Positive, Field(le=255)]
    """Read noise: standard deviation of a dark pixel, grey levels."""
    shot: Annotated[Positive, Field(le=255)]
    """Shot noise: variance in grey levels² per grey level of signal, at gain 1."""
    serial: Annotated[str, Field(min_length=1)] | None = None
    """Serial number; recordings of another camera are refused. Empty: any camera."""


class FieldHead(FrozenModel):
    """One flat field: its camera, light and file."""

    camera: Annotated[Whole, Field(ge=0)]
    """Number of the camera."""
    light: Annotated[str, Field(max_length=100)] | None = None
    """Name of the light. Empty: frames without a named light."""
    file: FileName
    """Picture of the flat field; the mean over all cameras and lights is 1."""
    level: Positive
    """Mean of the white target over the frame, grey levels per µs at gain 1."""
    rows: Annotated[Whole, Field(ge=1)]
    """Number of rows from which it was made."""
    white: tuple[Share, Share, Share] | None = None
    """Red, green and blue of the white target as shares of its grey level. Empty: the camera is grey, or its colours
    are not balanced."""


class FlatFieldDocument(FrozenModel):
    """The content of flatfield.json."""

    format: Literal["vaoi-flatfield"]
    version: Literal[1]
    created: str | None = None
    """Time at which the white target was measured, ISO 8601."""
    cameras: Annotated[tuple[CameraFields, ...], Field(min_length=1)]
    """One entry per camera, in the order of the calibration."""
    fields: Annotated[tuple[FieldHead, ...], Field(min_length=1)]
    """One entry for each camera and light."""

    @model_validator(mode="after")
    def _one_field_for_each(self) -> Self:
        keys = [(f.camera, f.light) for f in self.fields]
        lights = sorted({light for _, light in keys}, key=str)
        wanted = {(camera, light) for camera in range(len(self.cameras)) for light in lights}
        if len(set(keys)) != len(keys) or set(keys) != wanted:
            raise ValueError(
                f"fields has {len(keys)} entries, must have one for each of {len(self.cameras)} cameras and "
                f"{len(lights)} lights"
            )
        return self


class WhiteBalance(NamedTuple):
    """What makes a white target grey in the pictures of one camera under one light."""

    gains: tuple[float, float, float]
    """Factors of red, green and blue, at least 1: what is saturated stays so, and white."""
    dark: float = 0.0
    """Dark level of the camera, 8-bit grey levels, which is not multiplied."""

    @property
    def brightness(self) -> float:
        """Factor by which it makes the luminance of a white target brighter (BT.601)."""
        return 1 / sum(w / gain for w, gain in zip((0.299, 0.587, 0.114), self.gains, strict=True))

    def applied(self, picture: NDArray[Any]) -> NDArray[Any]:
        """Return a picture (h, w, 3) of 8 or 16 bits with balanced colours; one in grey as it is."""
        if picture.ndim == 2:
            return picture
        factors = np.array(self.gains[::-1])  # OpenCV stores colours as blue, green, red
        black = self.dark * np.iinfo(picture.dtype).max / 255
        return np.asarray(cv2.transform(picture, np.column_stack([np.diag(factors), black * (1 - factors)])))


@dataclass(frozen=True, eq=False)
class FieldMaps:
    """What turns grey levels of one camera under one light into radiance."""

    flat: Floats32 | None
    """(h, w), mean 1 over all cameras and lights of the array; None without a flat field."""
    dark: Floats32 | float
    """Grey level of darkness: (h, w), or one value for all pixels."""
    noise: NoiseModel


@dataclass(frozen=True, eq=False)
class FlatFields:
    """The flat fields of an array, or none at all."""

    document: FlatFieldDocument | None = None
    flats: Mapping[tuple[int, str | None], Floats32] = field(default_factory=dict)
    """Flat fields (h, w) by camera and light."""
    darks: Mapping[int, Floats32] = field(default_factory=dict)
    """Dark levels (h, w) by camera, where they differ from pixel to pixel."""
    source: str = "the flat fields"
    """Where they come from, for messages."""
    noise: NoiseModel = field(default_factory=NoiseModel)
    """Noise of all cameras without flat fields."""
    dark: float = 0.0
    """Dark level of all cameras without flat fields."""

    @classmethod
    def none(cls, noise: NoiseModel | None = None, dark: float = 0.0) -> FlatFields:
        """Return the absence of flat fields: flat 1, one dark level and one noise for all cameras."""
        return cls(noise=noise or NoiseModel(), dark=dark)

    @classmethod
    def open(cls, directory: Path) -> FlatFields:
        """Read a directory that `vaoi flatfield` has written; raise `InputError` that names an unfit file."""
        document = _read_document(directory)
        flats = {(f.camera, f.light): _read(directory / f.file, document.cameras[f.camera]) for f in document.fields}
        darks = {i: _read(directory / c.dark_file, c, -1.0) for i, c in enumerate(document.cameras) if c.dark_file}
        return cls(document, flats, darks, str(directory))

    @classmethod
    def peek(cls, directory: Path) -> FlatFields:
        """Read the document alone, without pictures: enough for `check`."""
        return cls(_read_document(directory), source=str(directory))

    def __bool__(self) -> bool:
        return self.document is not None

    @property
    def lights(self) -> tuple[str | None, ...]:
        """The lights for which there is a flat field; (None,) where the white target had no named light."""
        return tuple(dict.fromkeys(f.light for f in self.document.fields)) if self.document else ()

    @property
    def named_lights(self) -> tuple[str, ...] | None:
        """The names of the lights; None where the white target had no named light."""
        return tuple(light for light in self.lights if light is not None) or None

    def age_days(self, now: datetime) -> float | None:
        """Return how many days ago the white target was measured; None if that is not known."""
        if self.document is None or self.document.created is None:
            return None
        try:
            created = datetime.fromisoformat(self.document.created)
        except ValueError:
            return None
        return (now - created.astimezone(UTC)).total_seconds() / 86400

    def maps(self, camera: int, light: str | None) -> FieldMaps:
        """Return the maps of one camera and light; raise `InputError` if there are flat fields, but none of these."""
        if self.document is None:
            return FieldMaps(None, self.dark, self.noise)
        if camera >= len(self.document.cameras):
            raise InputError(
                f"{self.source}: have {len(self.document.cameras)} cameras, but camera {camera} is asked for (from 0).",
                action=_MAKE,
            )
        flat = self.flats.get((camera, light))
        if flat is None:
            raise self._other_light(light)
        found = self.document.cameras[camera]
        return FieldMaps(flat, self.darks.get(camera, float(found.dark)), NoiseModel(found.read, found.shot))

    @cached_property
    def white_balances(self) -> Mapping[tuple[int, str | None], WhiteBalance]:
        """The white balance by camera and light, of cameras in colour under white light.

        The channel that is strongest in any camera of a light keeps its grey levels, and so do the ratios of cameras.
        """
        found: dict[tuple[int, str | None], WhiteBalance] = {}
        if self.document is None:
            return found
        for light in self.lights:
            whites = {f.camera: f.white for f in self.document.fields if f.light == light and f.white is not None}
            if any(min(white) <= _LEAST_CHANNEL * max(white) for white in whites.values()):
                continue
            most = max((max(white) for white in whites.values()), default=1.0)
            for camera, (red, green, blue) in whites.items():
                gains = most / red, most / green, most / blue
                found[camera, light] = WhiteBalance(gains, self.document.cameras[camera].dark)
        return found

    def check(self, cameras: Sequence[CameraHead], lights: Sequence[str] | None) -> None:
        """Raise `InputError` if number, frame sizes, lights or serial numbers (where both are known) differ."""
        if self.document is None:
            return
        found = self.document.cameras
        if len(found) != len(cameras):
            raise InputError(
                f"{self.source}: are of an array of {len(found)} cameras, but {len(cameras)} cameras were filming.",
                action=_MAKE,
            )
        for i, (mine, head) in enumerate(zip(found, cameras, strict=True)):
            size, other = ((c.width, c.height) for c in (mine, head))
            wrong = f"{self.source}: the field of camera {i} "
            if size != other:
                message = f"{wrong}has {size[0]}×{size[1]} px, but its frames have {other[0]}×{other[1]} px."
                raise InputError(message, action=_MAKE)
            if None not in (mine.serial, head.serial) and mine.serial != head.serial:
                message = f"{wrong}is that of serial number {mine.serial}, but its frames are of {head.serial}."
                raise InputError(message, action=_MAKE)
        for light in dict.fromkeys(lights or (None,)):
            if light not in self.lights:
                raise self._other_light(light)

    def check_head(self, head: RecordingHead) -> None:
        """Refuse a recording of another array, resolution or light; see `check`."""
        self.check(head.cameras, head.lights)

    def _other_light(self, light: str | None) -> InputError:
        names = ", ".join(repr(name) if name is not None else "an unnamed light" for name in self.lights)
        wanted = "frames without a named light" if light is None else f"the light {light!r}"
        return InputError(
            f"{self.source}: have no field for {wanted}; there are {len(self.lights)}: {names}.",
            action="Film the white target under every light of the program, and run 'vaoi flatfield' again.",
        )


def write_flat_fields(directory: Path, fields: FlatFields) -> None:
    """Write flat fields into a directory that exists (a draft of `files.atomic_directory.new_directory`)."""
    document = fields.document
    assert document is not None, "only measured fields are written"
    for head in document.fields:
        write_bytes(directory / head.file, encode_tiff(fields.flats[head.camera, head.light]), durable=False)
    for i, camera in enumerate(document.cameras):
        if camera.dark_file is not None:
            write_bytes(directory / camera.dark_file, encode_tiff(fields.darks[i]), durable=False)
    write_json(directory / DOCUMENT, document.model_dump(mode="json", exclude_none=True))


def fitting_balances(
    directory: Path | None, head: RecordingHead | None
) -> Mapping[tuple[int, str | None], WhiteBalance]:
    """Return the white balances of flat fields for a run; none if they do not fit, of which the station warns."""
    if directory is None or head is None:
        return {}
    try:
        fields = FlatFields.peek(directory)
        fields.check_head(head)
    except VaoiError:
        return {}
    return fields.white_balances


def _read_document(directory: Path) -> FlatFieldDocument:
    path = directory / DOCUMENT
    data = read_json(path)
    check_format(data, path, "vaoi-flatfield", 1)
    return parse(FlatFieldDocument, data, path)


def _read(path: Path, camera: CameraFields, least: float = 0.0) -> Floats32:
    """Read one picture of 32-bit floats and check it against its camera."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).", action=_MAKE) from error
    image = decode(content)
    if image is None or image.dtype != np.float32 or image.ndim != 2:
        raise InputError(f"{path}: is not a grey TIFF of 32-bit floats.", action=_MAKE)
    if image.shape != (camera.height, camera.width):
        raise InputError(
            f"{path}: is {image.shape[1]}×{image.shape[0]} px, but {DOCUMENT} says {camera.width}×{camera.height} px."
        )
    low, high, *_ = cv2.minMaxLoc(image)
    if not np.isfinite(image).all() or low < least or high > _LARGEST:
        raise InputError.field(path, "range", f"{low:g} to {high:g}", f"{least:g} to {_LARGEST:g}", _MAKE)
    image.setflags(write=False)
    return image


def changed_ns(directory: Path | None) -> int:
    """Return when the flat fields of a directory were written, ns; 0 if there are none."""
    try:
        return 0 if directory is None else (directory / DOCUMENT).stat().st_mtime_ns
    except OSError:
        return 0
