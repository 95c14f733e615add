"""The manifest of an archived run: what it is, and the blobs that it consists of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal
from urllib.parse import quote

from pydantic import AfterValidator, Field

from vaoi_station.model import Status, Strict, Whole

RUNS, BLOBS, DRAFTS = "runs", "blobs", "drafts"
"""First part of the keys of manifests, of blobs, and of runs that are being added."""
DocumentKind = Literal["head", "calibration", "board_type", "result", "light_program", "run"]
FOLDER_BYTES = 255
"""Longest name of a folder of common file systems."""
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def _is_a_time(text: str) -> str:
    """Refuse a day or an hour that does not exist: the day is a part of the key of the manifest."""
    datetime.fromisoformat(text)
    return text


def _fits_a_folder(station: str) -> str:
    """Refuse a name that no file system takes as the name of a folder."""
    if (size := len(station_folder(station))) > FOLDER_BYTES:
        raise ValueError(f"takes {size} bytes as the name of a folder, must be at most {FOLDER_BYTES}")
    return station


_Time = Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z$"), AfterValidator(_is_a_time)]


@dataclass(frozen=True)
class RunLabel:
    """What an archive knows a run by, where the recording does not state it or is to be named otherwise."""

    run: str | None = None
    """Id; None: that of the station which filmed the run, or a digest of the frames."""
    time: str | None = None
    """Begin of the run in UTC, RFC 3339 with a Z; None: as the recording states, or when it was written."""
    serial: str | None = None
    """Id of the board; None: as the station reported it."""


class Blob(Strict):
    """A stored object: SHA-256 and number of its bytes as they are stored."""

    sha256: Sha256
    bytes: Annotated[Whole, Field(ge=0)]

    @property
    def key(self) -> str:
        """Place in the archive."""
        return f"{BLOBS}/{self.sha256[:2]}/{self.sha256}"


class DocumentBlob(Blob):
    """A stored document."""

    packed: bool = False
    """Whether it is compressed by zlib."""


class FrameBlob(Blob):
    """A stored frame."""

    camera: Annotated[Whole, Field(ge=0)]
    row: Annotated[Whole, Field(ge=0)]


class ArchivedReference(Strict):
    """The run against which the station placed the board, as the directory of its reference has it."""

    run: str
    documents: dict[DocumentKind, DocumentBlob]
    frames: tuple[FrameBlob, ...]

    @property
    def blobs(self) -> tuple[Blob, ...]:
        """All blobs of the reference, which later runs of the board type have too."""
        return (*self.documents.values(), *self.frames)


class ArchivedRun(Strict):
    """One run of an archive, as its manifest states it."""

    format: Literal["vaoi-archived-run"] = "vaoi-archived-run"
    version: Literal[1] = 1
    run: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
    station: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_fits_a_folder)]
    time: _Time
    board_type: str
    revision: str | None = None
    """Revision of the data of the board type, as their owner names it."""
    verdict: Status | None = None
    """Verdict of the result; None if there is none."""
    serial: str | None = None
    """Id of the board; None if the station did not know it."""
    pixels: Annotated[Whole, Field(ge=0)]
    """Number of pixels of all frames."""
    documents: dict[DocumentKind, DocumentBlob]
    frames: tuple[FrameBlob, ...]
    reference: ArchivedReference | None = None
    """None: the station used none, or it was deleted before the run was archived."""

    @property
    def key(self) -> str:
        """Place of the manifest in the archive."""
        return manifest_key(self.station, self.time, self.run)

    @property
    def draft_key(self) -> str:
        """Place of the note that the run is being added."""
        return f"{DRAFTS}/{station_folder(self.station)}/{self.run}.json"

    @property
    def blobs(self) -> tuple[Blob, ...]:
        """All blobs of the run; one may be there twice."""
        return (*self.documents.values(), *self.frames, *(self.reference.blobs if self.reference else ()))

    @property
    def bytes(self) -> int:
        """Size of the blobs of the run as they are stored; other runs may share some of them."""
        return sum(blob.bytes for blob in {blob.sha256: blob for blob in self.blobs}.values())

    def text(self) -> str:
        """Return the text of the manifest: equal runs have equal ones."""
        document = self.model_dump(mode="json", exclude_none=True)
        return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @property
    def digest(self) -> str:
        """Digest of the manifest, 16 hex digits: equal runs have equal ones."""
        return digest_of(self.text().encode())[:16]


def manifest_key(station: str, time: str, run: str) -> str:
    """Return the place of a manifest: by station and day, so that a selection lists only what it needs."""
    return f"{RUNS}/{station_folder(station)}/{time[:10]}/{run}.json"


def station_folder(station: str) -> str:
    """Return the name of a station as one part of a key, reversible by URL decoding."""
    quoted = quote(station, safe=" ")
    return quoted if quoted.strip(".") else quoted.replace(".", "%2E")


def digest_of(content: bytes) -> str:
    """Return the SHA-256 by which a blob is addressed."""
    return hashlib.sha256(content).hexdigest()


def frames_digest(frames: Iterable[FrameBlob]) -> str:
    """Return a run id for a recording without one: equal frames have equal ids."""
    listed = "".join(f"{frame.camera} {frame.row} {frame.sha256}\n" for frame in frames)
    return f"frames-{digest_of(listed.encode())[:20]}"
