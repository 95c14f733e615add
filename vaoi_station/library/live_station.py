"""A running station, used over REST (docs/rest.md): its line, its board types, imports of board data, and its runs."""

from __future__ import annotations

import io
import math
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path
from secrets import token_hex
from typing import Any, Literal, TypedDict, Unpack
from urllib.parse import quote, urlsplit

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from vaoi_station.api.rest_models import (
    BoardTypeList,
    BoardTypeVersions,
    ComponentList,
    ComponentViews,
    MergedEntry,
    MergedList,
    MosaicEntry,
    MosaicList,
)
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.clamping import Clamped, request_of
from vaoi_station.config import MethodName
from vaoi_station.demo.client import Client, checked, unusable_reply
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files.caller_credentials import caller_credentials
from vaoi_station.files.documents import read_text
from vaoi_station.library.arguments import (
    require_instance,
    require_path,
    require_text,
    require_whole,
)
from vaoi_station.library.board_data import ImportChoices
from vaoi_station.library.component_images import ComponentImages, component_height, made_image
from vaoi_station.library.picture_stream import ComponentPictures, read_pictures
from vaoi_station.model import BoardType, Reason, Status, Stitch
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.model.board_type import BoardTypeState
from vaoi_station.rendering.request import ImageOptions, ImageRequest
from vaoi_station.runs.archive.board_type_history import BoardTypeVersion
from vaoi_station.runs.board_sides import BoardDocument, BoardSide, SideName, join_sides
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.states.schemas import (
    BoardTypeSummary,
    CalibrationStatus,
    Choice,
    GoodBoards,
    HeightEntry,
    HeightList,
    LeaseStatus,
    LimitsReport,
    OrderList,
    OrderStatus,
    PartPage,
    PartsDocument,
    ReferenceStatus,
    RunCounts,
    StitchingMethod,
    Timeline,
)

_PAGE = 500
"""Largest number of runs in one reply of a station."""
_AWAITED_S = 10.0
"""Time from the first access to a result during which its later entries are awaited, s."""
_CORNERS = ("x0", "y0", "x1", "y1")
Box = tuple[float, float, float, float]
"""A part of a board: x0, y0, x1, y1, CAD coordinates in the unit of the board type."""
_PREVIEWS = "/board-data/previews"


class StationBoardTypes:
    """The board types of a station. Changes apply from the next arming on.

    A `tag` names the version that the caller has read (`get_tagged`); if the board type was changed since, a change
    with this tag is refused with the code `changed`.
    """

    def __init__(self, client: Client) -> None:
        self._client = client

    def list(self) -> tuple[BoardTypeSummary, ...]:
        """Return a summary of each board type, sorted by name; `fault` says why a file cannot be used."""
        return tuple(self._client.read(BoardTypeList, "/board-types").board_types)

    def deleted(self) -> tuple[str, ...]:
        """Return the names of deleted board types, of which a version can be restored."""
        return tuple(self._client.read(BoardTypeList, "/board-types").deleted)

    def get(self, name: str) -> BoardType:
        """Return a board type."""
        return self._client.read(BoardType, _path(name))

    def get_tagged(self, name: str) -> tuple[BoardType, str]:
        """Return a board type, and the tag of this version."""
        path = _path(name)
        document, tag = self._client.tagged(path)
        return checked(BoardType, document, self._client.url(path)), tag

    def put(self, board_type: BoardType, *, tag: str | None = None, new: bool = False) -> BoardType:
        """Store a board type under its name, or replace it; the version before can be restored.

        `tag`: replace only the version with this tag. `new`: refuse if there is a board type of this name.
        """
        require_instance("put", "board_type", board_type, BoardType)
        document = board_type.model_dump(mode="json", exclude_none=True)
        return self._client.write(BoardType, "PUT", _path(board_type.name), document, _conditions(tag, new=new))

    def delete(self, name: str, *, tag: str | None = None) -> None:
        """Delete a board type, of which a version is kept; refused while the line is armed with it."""
        self._client.act("DELETE", _path(name), headers=_conditions(tag))

    def set_state(self, name: str, state: BoardTypeState, revision: str | None = None) -> BoardType:
        """Set the state `draft`, `approved` or `retired`, and the revision of the data if it is given."""
        document = {"state": state} | ({} if revision is None else {"revision": revision})
        return self._client.write(BoardType, "PUT", _path(name, "state"), document)

    def set_limits(self, name: str, limits: Mapping[str, Any], *, store: bool = True) -> LimitsReport:
        """Set the limits beyond which measures of parts are marked; see in the reply what they would have marked.

        `limits` is as `limits` of a board type: {"every": {"presence": 0.5}, "packages": {…}, "parts": {…}}.
        `store=False` changes nothing: only the reply is made.
        """
        if not store:
            return self._client.write(LimitsReport, "POST", _path(name, "limits", "check"), dict(limits))
        return self._client.write(LimitsReport, "PUT", _path(name, "limits"), dict(limits))

    def versions(self, name: str) -> tuple[BoardTypeVersion, ...]:
        """Return the versions that were replaced or deleted, newest first."""
        return tuple(self._client.read(BoardTypeVersions, _path(name, "revisions")).revisions)

    def version(self, name: str, version: str) -> BoardType:
        """Return the document of a version; `latest` is the one before the present."""
        return self._client.read(BoardType, _path(name, "revisions", version))

    def restore(self, name: str, version: str = "latest") -> BoardType:
        """Put a version in force again; the present one becomes a version itself."""
        return self._client.write(BoardType, "POST", _path(name, "revisions", version, "restore"), {})

    def reference(self, name: str) -> ReferenceStatus | None:
        """Return the run against which boards of the type are placed; None if there is none."""
        try:
            return self._client.read(ReferenceStatus, _path(name, "reference"))
        except NotFoundError as error:
            if error.code != "no-reference":
                raise
            return None

    def teach(self, name: str, run: str, *, confirm_orientation: bool = False) -> ReferenceStatus:
        """Make a finished run, whose verdict is `ok` and whose frames are in memory, the reference of its board type.

        `confirm_orientation`: a person has checked that the board did not lie turned by 180°.
        """
        document = {"run": run, "confirm_orientation": confirm_orientation}
        return self._client.write(ReferenceStatus, "PUT", _path(name, "reference"), document)

    def forget_reference(self, name: str) -> None:
        """Delete the reference of a board type."""
        self._client.act("DELETE", _path(name, "reference"))

    def method(self, name: str) -> StitchingMethod:
        """Return the stitching method of a board type, and whether it was set for it."""
        return self._client.read(StitchingMethod, _path(name, "method"))

    def set_method(self, name: str, method: MethodName) -> StitchingMethod:
        """Set the stitching method of a board type."""
        return self._client.write(StitchingMethod, "PUT", _path(name, "method"), {"method": method})

    def forget_method(self, name: str) -> StitchingMethod:
        """Delete the method that was set for a board type; return the station's, which applies then."""
        return self._client.write(StitchingMethod, "DELETE", _path(name, "method"))


@dataclass(frozen=True, eq=False)
class MergedPicture:
    """A picture in linear radiance that was merged of frames of several exposures."""

    facts: MergedEntry
    """Its frames, exposures, lights, size and matrices."""
    _load: Callable[[bool], NDArray[Any]] = field(repr=False)

    @cached_property
    def radiance(self) -> NDArray[np.float32]:
        """(h, w) grey levels per µs at gain 1; NaN where no frame gives a valid value."""
        return self._load(False)

    @cached_property
    def sigma(self) -> NDArray[np.float32]:
        """(h, w) standard deviation of `radiance`."""
        return self._load(True)


@dataclass(frozen=True, eq=False)
class StationRun:
    """One run of a station. Its images can be fetched while the station keeps the frames of the run."""

    id: str
    summary: dict[str, Any]
    """The reply of the station to `GET runs/{id}`."""
    _client: Client = field(repr=False)

    @property
    def result(self) -> Stitch:
        """Matrices, uncertainty and verdict of the run, fetched at the first access.

        Directly after the run, `quality["later"]` names entries that follow within moments: for ten seconds, it is then
        fetched again at each access, and once after them. What is missing then, the station does not have.
        """
        now_s, own = time.monotonic(), self.__dict__
        until_s = own.setdefault("_awaited_until_s", now_s + _AWAITED_S)
        known: Stitch | None = own.get("_result")
        if known is None or ("later" in known.quality and own["_fetched_s"] < until_s):
            known, own["_fetched_s"] = self._client.read(Stitch, self._path("matrices")), now_s
            own["_result"] = known
        return known

    @property
    def status(self) -> Status:
        """The verdict of the run: ok, degraded or failed. Its faults and identity may lower that of the result."""
        return Status(self.summary.get("verdict") or self.result.status)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for a verdict other than ok, in sentences: those of the result, then those of the run."""
        if self.status is Status.OK:
            return self.result.reasons
        of_run = (str(reason["message"]) for reason in self.summary.get("reasons", ()))
        return (*self.result.reasons, *(text for text in of_run if text not in self.result.reasons))

    @cached_property
    def refs(self) -> tuple[str, ...]:
        """Addresses of all components of the board type."""
        listing = self._client.read(ComponentList, self._path("components"))
        return tuple(entry.address for entry in listing.components)

    def component(self, ref: str, **options: Unpack[ImageOptions]) -> ComponentImages:
        """Return the images of a component from every frame that shows it. Pixels are fetched when they are accessed.

        Args:
            ref: address of the component.
            **options: the fields of `ImageOptions`, which docs/rest.md describes ("Choosing images").

        Raises:
            InputError: an option is not of its type, or outside its limits, or the run has no such light.
            NotFoundError: the board type has no such component.
            GoneError: at access to pixels, if the station no longer keeps the frames of the run.
        """
        require_text("component", "ref", ref)
        wanted = ImageRequest.of(options)
        # On a panel, `ref` is `panel/ref`; `quote` keeps the slash, which the path of the component contains as well.
        reply = self._client.read(ComponentViews, self._path(f"components/{quote(ref)}"), **wanted.options())
        height, sigma = component_height(self.result, ref)
        images = tuple(made_image(dict(view), partial(self._pixels, view.url)) for view in reply.views)
        return ComponentImages(ref, images, height, sigma, self.status, reply.remark)

    def pictures(self, *components: str, **options: Unpack[ImageOptions]) -> Iterator[ComponentPictures]:
        """Yield the pictures of many components, each when all of its pictures have arrived, from one request.

        Without `components`: of all components of the run. Options and errors are as for `component`.
        """
        yield from self._streamed(ImageRequest.of(options), component=components or None)

    def region(self, region: Box, **options: Unpack[ImageOptions]) -> ComponentPictures:
        """Return the pictures of a part of the board, best first; options as for `component`."""
        found = list(self._streamed(ImageRequest.of(options), region=_box("region", region)))
        if len(found) != 1:
            path = self._client.url(self._path("images"))
            raise unusable_reply(path, f"{len(found)} regions where one was asked for")
        return found[0]

    def _streamed(self, wanted: ImageRequest, **query: object) -> Iterator[ComponentPictures]:
        path = self._path("images")
        with self._client.opened(path, **query, format="raw", **wanted.options()) as reply:
            yield from read_pictures(reply, self._client.url(path))

    def frame(self, camera: int, row: int, *, incomplete: bool = False) -> NDArray[Any]:
        """Return a frame as the camera delivered it, (h, w) or (h, w, 3), 8 or 16 bit.

        `incomplete`: also if packets are missing, or if nothing proves that it is of this row; else StateError.
        """
        query = {"format": "npy", "incomplete": "show" if incomplete else None}
        return self._array(self._path(f"frames/{camera}/{row}"), **query)

    def merged(
        self,
        component: str | None = None,
        *,
        region: Box | None = None,
        light: str | None = None,
        px_per_mm: float | None = None,
        min_coverage: float | None = None,
    ) -> tuple[MergedPicture, ...]:
        """Return pictures in linear radiance of a component or a region; the last one is of all frames of a light.

        Args:
            component: address of the component; or give `region`, a part of the board.
            region: see `component`.
            light: merge the frames under this light; by default that of most frames of the run.
            px_per_mm: resolution; by default that of the cameras.
            min_coverage: omit frames that show a smaller share.
        """
        query = {
            "component": component,
            "region": None if region is None else _box("merged", region),
            "light": light,
            "px_per_mm": px_per_mm,
            "min_coverage": min_coverage,
        }
        listing = self._client.read(MergedList, self._path("merged"), **query)

        def picture(facts: MergedEntry) -> MergedPicture:
            def load(sigma: bool) -> NDArray[Any]:
                return self._array(f"{facts.url}&format=npy{'&sigma=true' if sigma else ''}")

            return MergedPicture(facts, load)

        return tuple(map(picture, listing.pictures))

    def mosaics(self) -> tuple[MosaicEntry, ...]:
        """Return the pictures of the whole board that the station offers: by light, by exposure, and merged."""
        return tuple(self._client.read(MosaicList, self._path("mosaics")).mosaics)

    def save_mosaic(
        self, name: str, path: str | Path, *, region: Box | None = None, px_per_mm: float | None = None
    ) -> None:
        """Write one of `mosaics`, or a region of it, as a tiled, pyramidal TIFF; the file is complete or unchanged."""
        target = require_path("save_mosaic", "path", path)
        values = () if region is None else _box("save_mosaic", region).split(",")
        corners = dict(zip(_CORNERS, values, strict=bool(values)))
        address = self._path(f"mosaics/{quote(require_text('save_mosaic', 'name', name), safe='')}.tif")
        # Calls at the same time write to several drafts, so that they do not mix them.
        part = target.with_name(f".{target.name}.{token_hex(4)}.part")
        try:
            with self._client.opened(address, px_per_mm=px_per_mm, **corners) as reply, part.open("wb") as file:
                shutil.copyfileobj(reply, file)
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)

    def heights(self) -> Mapping[str, HeightEntry]:
        """Return the heights of the components above the board, by address; GoneError if they were not measured."""
        return self._client.read(HeightList, self._path("heights")).heights

    def clamped(self, readings: Mapping[str, Sequence[float]], /, **options: Any) -> Clamped:
        """Return where the board lies that a tester has clamped, in the tester's coordinates.

        Args:
            readings: where it reads fiducials, (x, y) or (x, y, z), by name.
            **options: other fields of the request of `POST runs/{id}/clamped`: `sigma=0.01`, `points=["U1"]`, …
        """
        wanted = request_of(readings, options)
        return self._client.write(Clamped, "POST", self._path("clamped"), wanted.model_dump(exclude_none=True))

    def parts(self) -> PartsDocument:
        """Return the measures of the parts of the run; GoneError if they were not measured while frames were there."""
        return self._client.read(PartsDocument, self._path("parts"))

    def part(self, ref: str) -> PartPage:
        """Return one part: its measure, its limits, and the addresses of its pictures beside those of a good board."""
        return self._client.read(PartPage, self._path(f"parts/{quote(require_text('part', 'ref', ref))}"))

    def keep_as_good(self) -> GoodBoards:
        """Keep what the parts of this board look like, as those of a good board; see the reply's doubts."""
        return self._client.write(GoodBoards, "PUT", self._path("good"))

    def remove_from_good(self) -> GoodBoards:
        """Remove this board from the good ones of its type."""
        return self._client.write(GoodBoards, "DELETE", self._path("good"))

    def timeline(self) -> Timeline:
        """Return the times of the steps of the run: frames, links, result, and what followed."""
        return self._client.read(Timeline, self._path("timeline"))

    def identity(self, timeout_s: float = 0.0) -> IdentityDocument:
        """Return which board the run shows: the ids that were armed, read and reported, and whether they agree.

        `timeout_s`, at most 60, is the longest wait for the codes; before they are read, `state` is `pending`.
        """
        return self._client.read(IdentityDocument, self._path("identity"), timeout=timeout_s)

    def report_next_machine(self, board_id: str, machine: str = "") -> IdentityDocument:
        """Report the id that the next machine of the line has read of this board; return the ids compared."""
        fields = {"board_id": board_id, "machine": machine}
        return self._client.write(IdentityDocument, "PUT", self._path("identity/next-machine"), fields)

    def decide(self, choice: Choice, name: str, reason: str) -> None:
        """Keep what a person has decided: `film-again`, or `use` the pictures despite the verdict, which stays."""
        self._client.act("PUT", self._path("decision"), {"choice": choice, "name": name, "reason": reason})

    def pin(self) -> None:
        """Keep the run until it is unpinned: result and record, and its frames as a recording if they are there."""
        self._client.act("PUT", self._path("pin"))

    def unpin(self) -> None:
        """Remove the pin; the run is then deleted like other runs."""
        self._client.act("DELETE", self._path("pin"))

    def hold(self, holder: str, purpose: str = "") -> LeaseStatus:
        """Keep the frames of the run in memory until the hold expires or ends; a repeated call renews the hold."""
        return self._client.write(LeaseStatus, "PUT", self._path("hold"), holder=holder, purpose=purpose)

    def end_hold(self, holder: str) -> None:
        """End the hold of `hold`; the frames stay as long as the station has memory for them."""
        self._client.act("DELETE", self._path("hold"), holder=holder)

    def release(self, holder: str | None = None) -> None:
        """Give up the frames of the run, so that the next board can use their memory; the result stays.

        `holder` is the name under which the caller held it. StateError: another caller holds the run.
        """
        self._client.act("POST", self._path("release"), {}, holder=holder or None)

    def check_board_type(self, name: str | None = None) -> BoardCheck:
        """Lay a board type of the station, by default that of the run, over the run's pictures; takes seconds."""
        return self._client.read(BoardCheck, self._path("board-check"), board_type=name)

    def board_check_picture(self, name: str | None = None) -> bytes:
        """Return the picture of `check_board_type` as JPEG: the components of the board type over the board."""
        return self._client.content(self._path("board-check/picture"), board_type=name)

    def correct_board_type(self, name: str, revision: str | None = None) -> BoardType:
        """Store the correction that `check_board_type` proposes, as a draft of the board type."""
        path = f"/board-types/{quote(name, safe='')}/correct"
        return self._client.write(BoardType, "POST", path, {"run": self.id, "revision": revision})

    def _path(self, rest: str) -> str:
        return f"/runs/{quote(self.id, safe='')}/{rest}"

    def _pixels(self, url: str) -> NDArray[Any]:
        return self._client.picture(url)[1]

    def _array(self, path: str, **query: Any) -> NDArray[Any]:
        content = self._client.content(path, **query)
        try:
            return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))
        except (ValueError, EOFError) as error:
            raise unusable_reply(self._client.url(path), f"{len(content)} bytes that are no array") from error


@dataclass(frozen=True, eq=False)
class StationImport:
    """A file with board data on a running station, not yet a board type."""

    document: dict[str, Any]
    """What the station has found: the reply of `GET board-data/previews/{id}`."""
    _client: Client = field(repr=False)

    @classmethod
    def upload(cls, client: Client, path: str | Path, options: dict[str, Any]) -> StationImport:
        """Send a file to a station."""
        file = require_path("upload_board_data", "path", path)
        try:
            content = file.read_bytes()
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror}.") from error
        # A table of sizes may be too long for an address: the file is read again with it.
        sizes = options.pop("sizes", None)
        found = cls(dict(client.upload(_PREVIEWS, content, filename=file.name, **options)), client)
        return found if sizes is None else found.correct(sizes=sizes, **options)

    @property
    def picture(self) -> bytes:
        """Outline, marks and bodies as SVG."""
        return self._client.content(f"{self._address}/picture")

    def correct(self, **options: Any) -> StationImport:
        """Read the file again with other options: `side`, `join` (id of another upload), and as for the upload."""
        if options.get("sizes") is not None:
            options["sizes"] = read_text(require_path("correct", "sizes", options["sizes"]))
        given = {name: value for name, value in options.items() if value is not None}
        reply = self._client.act("PUT", self._address, given)
        return StationImport(dict(reply), self._client)

    def confirm(self, *, tag: str | None = None, new: bool = False) -> BoardType:
        """Store the board type on the station, so that it can be armed; `tag` and `new` as for `board_types.put`."""
        headers = _conditions(tag, new=new)
        return self._client.write(BoardType, "POST", f"{self._address}/confirm", {}, headers)

    def board_type(self) -> BoardType:
        """Return the board type that `confirm` would store."""
        return self._client.read(BoardType, f"{self._address}/board-type")

    def discard(self) -> None:
        """Delete the file from the station; without this call it goes after an hour."""
        self._client.act("DELETE", self._address)

    @property
    def _address(self) -> str:
        return f"{_PREVIEWS}/{quote(str(self.document['id']))}"


class _RunPage(BaseModel):
    """A page of the list of runs, whose summaries are handed on as the station gives them."""

    runs: list[dict[str, Any]]
    next: str | None = None


class RunFilters(TypedDict, total=False):
    """Which runs a caller wants; a run passes that passes every filter."""

    verdict: Literal["ok", "degraded", "failed", "none"]
    board_type: str
    board_id: str
    read_id: str
    reason: str
    since: str | datetime
    until: str | datetime
    before: str


class OrderOptions(TypedDict, total=False):
    """What an order may state beside its board type."""

    board_id: str
    job_id: str
    skip: Sequence[str]
    side: Literal["top", "bottom"]
    flip: Literal["x", "y"]
    priority: int
    allow_lost_cameras: bool


class Station:
    """A connection to a running station. Every refusal is raised as the `VaoiError` that the station reports.

    Every method raises `DeviceError` with the address if the station does not reply, or replies with something else
    than a station of this version does.
    """

    def __init__(
        self,
        address: str,
        *,
        key: str | None = None,
        key_file: str | Path | None = None,
        ca: str | Path | None = None,
    ) -> None:
        """Set the address of the station, and how the caller is let in, as for `connect`. No request is sent yet."""
        if not isinstance(key, str | None):
            # The type only: a value of another type may still contain the key.
            raise InputError.field("connect", "key", type(key).__name__, "a text")
        files = {"key_file": key_file, "ca": ca}
        paths = (None if path is None else require_path("connect", name, path) for name, path in files.items())
        credentials = caller_credentials(*paths, key=key)
        self._client = Client(checked_address(address), credentials)
        self.board_types = StationBoardTypes(self._client)
        """The board types of the station."""

    def snapshot(self) -> dict[str, Any]:
        """Return the present state of the station as `GET station` gives it."""
        return self._given("/station", self._client.get("/station"))

    def arm(
        self,
        board_type: str,
        *,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
        passing: Passing | None = None,
    ) -> dict[str, Any]:
        """Arm the line: film every board from now on, or only the next `runs` boards. Return the station's state.

        Args:
            board_type: name of the board type.
            board_id: the caller's id of the next board; it is repeated in the result.
            job_id: the caller's id of the job, likewise.
            runs: number of runs after which the line is disarmed; None: it stays armed.
            allow_lost_cameras: arm although cameras are missing.
            passing: while a board passes, which keeps the order before: "wait" until it has left (the default), take
                effect "after" it and return at once, or "refuse".
        """
        count = None if runs is None else require_whole("arm", "runs", runs, 1, 1_000_000)
        order = {"board_type": board_type, "board_id": board_id, "job_id": job_id, "runs": count, "passing": passing}
        given = {name: value for name, value in order.items() if value is not None}
        given |= {"allow_lost_cameras": True} if allow_lost_cameras else {}
        return self._given("/station/arm", self._client.post("/station/arm", **given))

    def arm_for_orders(self, *, passing: Passing | None = None) -> dict[str, Any]:
        """Arm the line for the boards for which orders wait, and no others: the next board is the first order's."""
        given = {} if passing is None else {"passing": passing}
        return self._given("/station/arm", self._client.post("/station/arm", orders=True, **given))

    def orders(self) -> tuple[OrderStatus, ...]:
        """Return the orders that no board has taken yet, the next one first."""
        return self._client.read(OrderList, "/orders").orders

    def add_order(self, board_type: str, **options: Unpack[OrderOptions]) -> OrderStatus:
        """Let an order wait for its board, behind all of the same or a higher priority.

        Args:
            board_type: name of the board type.
            **options: `board_id`, `job_id`, `skip` (positions of a panel that are not to be tested), `side` ("top",
                "bottom": refused if the board type is of the other one), `flip` (axis of the tester about which the
                board was turned over since its other side was filmed), `priority`, `allow_lost_cameras`.
        """
        return self._client.write(OrderStatus, "POST", "/orders", {"board_type": board_type, **options})

    def move_order(self, order: str, *, position: int | None = None, priority: int | None = None) -> OrderStatus:
        """Give an order another position, 1 for the next board, or another priority."""
        change = {"position": position, "priority": priority}
        given = {name: value for name, value in change.items() if value is not None}
        return self._client.write(OrderStatus, "PATCH", f"/orders/{quote(order, safe='')}", given)

    def withdraw_order(self, order: str) -> None:
        """Withdraw an order that waits. A board that is at the barrier keeps it."""
        self._client.act("DELETE", f"/orders/{quote(order, safe='')}")

    def disarm(self) -> dict[str, Any]:
        """Disarm the line: film no further board. Return the station's state."""
        return self._given("/station/disarm", self._client.post("/station/disarm"))

    def events(self, after: int) -> Iterator[dict[str, Any]]:
        """Yield events numbered above `after`, and heartbeats, as they happen, until the station ends.

        `last_event` of `snapshot` is the number of the newest one.
        """
        yield from self._client.messages(require_whole("events", "after", after, 0, 2**53))

    def runs(self, limit: int = 50, **filters: Unpack[RunFilters]) -> list[dict[str, Any]]:
        """Return summaries of runs, newest first: the newest ones, or of those that all filters let pass.

        Args:
            limit: largest number of runs.
            **filters: `verdict` ("ok", "degraded", "failed", "none": without a result), `board_type`, `board_id` (the
                armed one), `read_id` (read from the board, or reported by the next machine), `reason` (a code or
                cause), `since` and `until` (times with a zone, RFC 3339 or datetime), `before` (id of a run).
        """
        missing = require_whole("runs", "limit", limit, 1, 1_000_000)
        query = _filters(filters)
        found: list[dict[str, Any]] = []
        # One reply has at most `_PAGE` runs, and with a filter it may have fewer although more follow.
        while missing > 0:
            page = self._client.read(_RunPage, "/runs", **query, limit=min(missing, _PAGE))
            found += page.runs
            missing -= len(page.runs)
            if page.next is None:
                break
            query["before"] = page.next
        return found

    def board(self, board_id: str, *others: Station, within_s: float = 3600.0) -> BoardDocument:
        """Return a board with its runs of top and bottom, and the parts of both in one coordinate system.

        `others` are stations that film the other side. Programs with asyncio give the `blocking` of these.

        NotFoundError: no run of any of them shows a board with this id, and no order is for it.
        """
        path, missing = f"/boards/{quote(require_text('board', 'board_id', board_id), safe='')}", None
        sides, coming, silent = list[BoardSide](), list[SideName](), list[Reason]()
        for station in (self, *others):
            try:
                found = station._client.read(BoardDocument, path, within=within_s, parts=True, alone=bool(others))
            except NotFoundError as error:
                missing = error
                continue
            for side in found.every_side:
                address = side.address if "://" in side.address else station._client.url(side.address)
                sides.append(side.model_copy(update={"address": address}))
            coming += found.coming
            silent += [reason for reason in found.reasons if reason.code == "other-station-silent"]
        if missing is not None and not sides and not coming:
            raise missing
        return join_sides(board_id, sides, within_s, coming, more=silent)

    def counts(self, since: str | datetime | None = None) -> RunCounts:
        """Return the numbers of boards by verdict, and of missed ones, since a time; by default since midnight."""
        query = _filters({} if since is None else {"since": since})
        return self._client.read(RunCounts, "/runs/counts", **query)

    def calibration(self) -> CalibrationStatus:
        """Return the calibration in force, with the displacement of every camera from it in the latest runs."""
        return self._client.read(CalibrationStatus, "/calibration")

    def run(self, run_id: str = "latest") -> StationRun:
        """Return a run by its id, by default the one that finished last."""
        path = f"/runs/{quote(require_text('run', 'run_id', run_id), safe='')}"
        return self._run(self._client.get(path), path)

    def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> StationRun | None:
        """Wait for the next finished run; return None if no run finishes in time.

        Args:
            after: id of the last run that the caller knows, so that no run is missed. By default the call returns the
                next run to finish.
            timeout_s: at most 60.
        """
        summary = self._client.get("/runs/next", after=after, timeout=timeout_s)
        return None if summary is None else self._run(summary, "/runs/next")

    def upload_board_data(
        self, path: str | Path, side: Literal["top", "bottom"] = "top", **choices: Unpack[ImportChoices]
    ) -> StationImport:
        """Send a file of a CAD system or placement machine to the station, which shows what it would make of it.

        Nothing is stored until `confirm` of the reply. Options are those of `import_board_data`.
        """
        return StationImport.upload(self._client, path, {"side": side, **choices})

    def _given(self, path: str, reply: Any) -> dict[str, Any]:
        if reply is None:
            raise unusable_reply(self._client.url(path), "no content")
        return dict(reply)

    def _run(self, summary: Any, path: str) -> StationRun:
        found = self._given(path, summary)
        if not isinstance(found.get("id"), str) or not found["id"]:
            raise unusable_reply(self._client.url(path), "another document than expected: it has no id")
        return StationRun(found["id"], found, self._client)


def connect(
    address: str = "http://127.0.0.1:8350",
    *,
    key: str | None = None,
    key_file: str | Path | None = None,
    ca: str | Path | None = None,
) -> Station:
    """Connect to a running station.

    Args:
        address: `http://HOST:PORT`, or `https://HOST:PORT` if the station has a certificate; with the path of a proxy
            such as `https://HOST/aoi`.
        key: the caller's key, needed from other machines than the station's. Better than a key in a program is a file.
        key_file: file that holds the key; by default the one that the environment variable VAOI_KEY_FILE names, or the
            key in VAOI_KEY.
        ca: PEM file with the certificate of the authority that signed the station's certificate, or with that
            certificate itself; by default that of VAOI_CA, else the authorities of the system.

    Raises:
        InputError: the address is not of this form, key or certificate cannot be read, or the station asks for a key or
            for one with another scope (codes `no-key`, `missing-scope`).
        DeviceError: no station replies at the address, or its certificate is not trusted.
    """
    station = Station(address, key=key, key_file=key_file, ca=ca)
    # One request now, so that a wrong address is an error here and not at the first use.
    station.snapshot()
    return station


def _filters(given: RunFilters) -> dict[str, str]:
    """Return filters as the parameters of a query; raise InputError for an unknown name or a wrong value."""
    query = {}
    for name, value in given.items():
        if name not in RunFilters.__annotations__:
            raise InputError.field("runs", name, value, f"one of {', '.join(RunFilters.__annotations__)}")
        if isinstance(value, datetime) and value.tzinfo is None:
            raise InputError.field("runs", name, str(value), "a time with its zone")
        query[name] = value.isoformat() if isinstance(value, datetime) else require_text("runs", name, value)
    return query


def checked_address(address: str) -> str:
    """Return the address without a slash at its end; raise InputError if it is not `http://HOST:PORT`."""
    if not isinstance(address, str) or not address.startswith(("http://", "https://")):
        raise InputError(f"address is {address!r}, but must start with http:// or https://.")
    try:
        parts = urlsplit(address)
        sound = bool(parts.hostname) and parts.port != 0
    except ValueError:  # a malformed IPv6 address, or a port that is not a number
        sound = False
    # Such characters would end the line of the request, and with it begin another request.
    if not sound or not address.isascii() or any(c.isspace() or not c.isprintable() for c in address):
        raise InputError(f"address is {address!r}, but must be http://HOST:PORT, for example http://127.0.0.1:8350.")
    return address.rstrip("/")


def _path(name: object, *rest: str) -> str:
    """Return the path of a board type, or of what follows it."""
    parts = (require_text("board types", "name", part) for part in (name, *rest))
    return f"/board-types/{'/'.join(quote(part, safe='') for part in parts)}"


def _conditions(tag: str | None, *, new: bool = False) -> dict[str, str]:
    """Return the headers by which a change replaces only the version with a tag, or none."""
    match = {} if tag is None else {"If-Match": require_text("board types", "tag", tag)}
    return match | ({"If-None-Match": "*"} if new else {})


def _box(function: str, region: Any) -> str:
    try:
        values = () if isinstance(region, str | bytes) else tuple(map(float, region))
    except (TypeError, ValueError, OverflowError):
        values = ()
    if len(values) != len(_CORNERS) or not all(map(math.isfinite, values)):
        raise InputError.field(function, "region", region, "four numbers: x0, y0, x1, y1")
    return ",".join(map(repr, values))
