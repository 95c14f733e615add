"""The manifest of an archived run, the record of its station, and which runs are meant."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal, NamedTuple
from urllib.parse import quote

from pydantic import AfterValidator, BaseModel, Field

from vaoi_station.config import MethodName
from vaoi_station.errors import InputError, VaoiError
from vaoi_station.files.documents import parse, read_json
from vaoi_station.model import Status, Strict, Whole
from vaoi_station.stitching.expectation import StitchTerms

RUNS, BLOBS, DRAFTS = "runs", "blobs", "drafts"
"""First part of the keys of manifests, of blobs, and of runs that are being added."""
DocumentKind = Literal["head", "calibration", "board_type", "result", "light_program", "run"]
FOLDER_BYTES = 255
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def _is_a_time(text: str) -> str:
    datetime.fromisoformat(text)
    return text


def _fits_a_folder(station: str) -> str:
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


class Blob(Strict):
    """A stored object: SHA-256 and number of its bytes as they are stored."""

    sha256: Sha256
    """SHA-256 of the stored bytes, which names the blob."""
    bytes: Annotated[Whole, Field(ge=0)]
    """Number of stored bytes."""

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
    """Camera of the frame."""
    row: Annotated[Whole, Field(ge=0)]
    """Row of the frame."""


class ArchivedReference(Strict):
    """The run against which the station placed the board, as the directory of its reference has it."""

    run: str
    """Id of the run."""
    documents: dict[DocumentKind, DocumentBlob]
    """Its documents."""
    frames: tuple[FrameBlob, ...]
    """Its frames."""

    @property
    def blobs(self) -> tuple[Blob, ...]:
        """All blobs of the reference, which later runs of the board type have too."""
        return (*self.documents.values(), *self.frames)


class ArchivedRun(Strict):
    """One run of an archive, as its manifest states it."""

    format: Literal["vaoi-archived-run"] = "vaoi-archived-run"
    version: Literal[1] = 1
    run: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
    """Id of the run."""
    station: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_fits_a_folder)]
    """Name of the station."""
    time: _Time
    """Begin of the run, UTC."""
    board_type: str
    """Name of the board type."""
    revision: str | None = None
    """Revision of the data of the board type, as their owner names it."""
    verdict: Status | None = None
    """Verdict, as the identity of the board leaves it. Empty: no result."""
    serial: str | None = None
    """Id of the board."""
    pixels: Annotated[Whole, Field(ge=0)]
    """Number of pixels of all frames."""
    documents: dict[DocumentKind, DocumentBlob]
    """By name: head (recording.json), calibration, board_type, result, light_program, run (the station's record)."""
    frames: tuple[FrameBlob, ...]
    """Every frame that is not missing: a PNG, with the recording's pixels bit for bit."""
    reference: ArchivedReference | None = None
    """The run against which the board was placed. Empty: there was none, or it was deleted before the run was
    archived."""

    @property
    def key(self) -> str:
        """Place of the manifest: by station and day, so that a selection lists only what it needs."""
        return f"{RUNS}/{station_folder(self.station)}/{self.time[:10]}/{self.run}.json"

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


@dataclass(frozen=True)
class RunSelection:
    """Conditions that a run must fulfil together; None admits every run."""

    board_type: str | None = None
    since: str | None = None
    """Earliest begin of a run: UTC, a day or RFC 3339."""
    until: str | None = None
    """Begin before which a run must have begun: the same; a day counts as a whole."""
    station: str | None = None
    """Name, or a pattern with * and ?."""
    verdict: Status | None = None

    def __post_init__(self) -> None:
        if self.since is not None:
            moment(self.since, "since")
        if self.until is not None:
            moment(self.until, "until")

    def admits(self, run: ArchivedRun) -> bool:
        """Return whether a run is meant."""
        return (
            _fits(run.board_type, self.board_type)
            and _fits(run.station, self.station)
            and (self.verdict is None or run.verdict is self.verdict)
            and (self.since is None or moment(run.time, "time") >= moment(self.since, "since"))
            and (self.until is None or moment(run.time, "time") < _end(self.until))
        )

    def admits_folder(self, station: str, day: str) -> bool:
        """Return whether runs of a station and day (YYYY-MM-DD) can be meant."""
        first, last = moment(day, "day"), _end(day)
        return (
            _fits(station, self.station)
            and (self.since is None or last > moment(self.since, "since"))
            and (self.until is None or first < _end(self.until))
        )


def moment(text: str, name: str) -> datetime:
    """Return a time in UTC from a day (its begin) or an RFC 3339 text; InputError names the field `name`."""
    try:
        parsed = datetime.fromisoformat(text)
        in_utc = parsed.astimezone(UTC) if parsed.tzinfo else parsed.replace(tzinfo=UTC)
    except (ValueError, OverflowError) as error:
        raise InputError.field(
            "selection", name, text, "a day (2026-03-01) or a time with its zone (2026-03-01T08:00:00Z)"
        ) from error
    if parsed.tzinfo is None and len(text) > len("2026-03-01"):
        raise InputError.field("selection", name, text, "a time with its zone, such as 2026-03-01T08:00:00Z")
    return in_utc


def _end(text: str) -> datetime:
    start = moment(text, "until")
    if len(text) > len("2026-03-01"):
        return start
    # The last day that a datetime can hold has no next one.
    return start.replace(hour=23, minute=59, second=59) if start.year == 9999 else start + timedelta(days=1)


def matches(name: str, pattern: str) -> bool:
    """Return whether a name is meant by itself or by a pattern with * and ?, which the name itself may contain."""
    # A bracket is one of a name, as in "line [2]"; fnmatch would take it as the beginning of a set of characters.
    return name == pattern or fnmatchcase(name, pattern.replace("[", "[[]"))


def _fits(name: str, pattern: str | None) -> bool:
    return pattern is None or matches(name, pattern)


class ArchiveFault(NamedTuple):
    """Something of an archive that cannot be used: the rest can."""

    what: str
    action: str

    def __str__(self) -> str:
        return f"{self.what} {self.action}".strip()

    @classmethod
    def of(cls, error: VaoiError) -> ArchiveFault:
        """Return the fault that an error states."""
        return cls(error.message, error.action)


OnFault = Callable[[ArchiveFault], None]


def ignore_fault(_: ArchiveFault) -> None:
    """Take no notice of a fault."""


RUN_FILE = "run.json"


class _Identity(BaseModel):
    state: str
    board_id: str | None = None


class RecordedReason(BaseModel):
    """A reason of a run."""

    code: str
    message: str


class MadeWith(BaseModel):
    """With what a station stitched a run."""

    method: MethodName
    reference: str | None = None
    """Id of the run against which the board was placed; None: without a reference."""
    terms: StitchTerms | None = None
    """None: of an earlier version, which did not state them."""


class StationRecord(BaseModel):
    """What an archive needs of run.json."""

    id: str
    started: str
    board_id: str | None = None
    verdict: Status | None = None
    identity: _Identity | None = None
    reasons: tuple[RecordedReason, ...] = ()
    made_with: MadeWith | None = None

    @property
    def serial(self) -> str | None:
        """Id of the board: that of its code, or that with which the line was armed."""
        return (self.identity.board_id if self.identity else None) or self.board_id


def read_record(folder: Path) -> StationRecord | None:
    """Read the record in a recording; None if no station filmed it.

    InputError if the codes of the board are still to be read, which may lower the verdict.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        return None
    record = parse(StationRecord, read_json(path), path)
    if record.identity is not None and record.identity.state == "pending":
        raise InputError(
            f"{path}: identity.state is 'pending': the verdict is not final until the codes of the board are read.",
            action="Add the run when its station has read them; copy the recording again if this is a copy.",
        )
    return record
