"""One run of a running station, used over REST (docs/rest.md): its result, its pictures, and what callers say of it."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from secrets import token_hex
from typing import Any, Literal, Unpack
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.report import BoardCheck
from vaoi_station.demo.client import Client, unusable_reply
from vaoi_station.errors import InputError
from vaoi_station.library.arguments import require_number, require_path, require_text, require_whole
from vaoi_station.library.component_images import FIELDS, ComponentImage, ComponentImages
from vaoi_station.library.picture_stream import ComponentPictures, read_pictures
from vaoi_station.library.replies import (
    ComponentListReply,
    ComponentReply,
    MergedListReply,
    MergedReply,
    MosaicListReply,
    MosaicReply,
    ViewReply,
    checked,
)
from vaoi_station.library.stitched_run import component_height
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.rendering.request import ImageOptions, ImageRequest
from vaoi_station.runs.states.decision_schemas import Choice
from vaoi_station.runs.states.height_schemas import HeightEntry, HeightList
from vaoi_station.runs.states.schemas import LeaseStatus
from vaoi_station.runs.states.timeline_schemas import Timeline

Box = tuple[float, float, float, float]
"""A part of a board: x0, y0, x1, y1, CAD coordinates in the unit of the board type."""


@dataclass(frozen=True, eq=False)
class MergedPicture:
    """A picture in linear radiance that was merged of frames of several exposures."""

    facts: MergedReply
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

    @cached_property
    def result(self) -> Stitch:
        """Matrices, uncertainty and verdict of the run, fetched at the first access."""
        path = self._path("matrices")
        return checked(Stitch, self._client.get(path), self._client.url(path))

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
        path = self._path("components")
        listing = checked(ComponentListReply, self._client.get(path), self._client.url(path))
        return tuple(entry.address for entry in listing.components)

    def component(self, ref: str, **options: Unpack[ImageOptions]) -> ComponentImages:
        """Return the images of a component from every frame that shows it. Pixels are fetched when they are accessed.

        Args:
            ref: address of the component.
            **options: `px_per_mm`, `margin_mm`, `align` ("cad", "part") and `plane` ("board", "top") frame the images;
                `light`, `seen_from` with `within_deg`, and bounds of coverage, exposure, angle, sharpness and
                saturation choose them; `order` ("best", "sharpest") and `limit` follow; `minus` subtracts another
                light; `measure` measures sharpness and saturation of each. docs/rest.md describes all of them.

        Raises:
            InputError: an option is not of its type, or outside its limits, or the run has no such light.
            NotFoundError: the board type has no such component.
            GoneError: at access to pixels, if the station no longer keeps the frames of the run.
        """
        require_text("component", "ref", ref)
        wanted = ImageRequest.of(options)
        # On a panel, `ref` is `panel/ref`; `quote` keeps the slash, which the path of the component contains as well.
        path = self._path(f"components/{quote(ref)}")
        reply = checked(ComponentReply, self._client.get(path, **wanted.options()), self._client.url(path))
        height, sigma = component_height(self.result, ref)
        images = tuple(self._image(view) for view in reply.views)
        return ComponentImages(ref, images, height, sigma, self.status, reply.remark)

    def pictures(self, *components: str, **options: Unpack[ImageOptions]) -> Iterator[ComponentPictures]:
        """Yield the pictures of many components, each when all of its pictures have arrived, from one request.

        Args:
            *components: addresses of components; none: all components of the run.
            **options: as for `component`.

        Raises:
            InputError: an option is not of its type, or outside its limits, or the run has no such light.
            NotFoundError: the board type has no such component.
            GoneError: the station no longer keeps the frames of the run, or gave up their memory meanwhile.
        """
        for ref in components:
            require_text("pictures", "component", ref)
        wanted = ImageRequest.of(options).options()
        path = self._path("images")
        with self._client.opened(path, component=components or None, format="raw", **wanted) as reply:
            yield from read_pictures(reply, self._client.url(path))

    def region(self, region: Box, **options: Unpack[ImageOptions]) -> ComponentPictures:
        """Return the pictures of a part of the board, best first; options as for `component`."""
        text = ",".join(f"{v!r}" for v in _box("region", region))
        wanted = ImageRequest.of(options).options()
        path = self._path("images")
        with self._client.opened(path, region=text, format="raw", **wanted) as reply:
            found = list(read_pictures(reply, self._client.url(path)))
        if len(found) != 1:
            raise unusable_reply(self._client.url(path), f"{len(found)} regions where one was asked for")
        return found[0]

    def frame(self, camera: int, row: int, *, incomplete: bool = False) -> NDArray[Any]:
        """Return a frame as the camera delivered it, (h, w) or (h, w, 3), 8 or 16 bit.

        Args:
            camera: number of the camera.
            row: number of the row.
            incomplete: return it also if packets are missing, or if nothing proves that it is of this row.

        Raises:
            StateError: the frame is incomplete or unproven, and `incomplete` is False.
            GoneError: the station no longer keeps the frames of the run.
        """
        numbers = require_whole("frame", "camera", camera, 0, 10_000), require_whole("frame", "row", row, 0, 1_000_000)
        path = self._path(f"frames/{numbers[0]}/{numbers[1]}")
        return self._array(path, incomplete="show" if incomplete else None)

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
            component: address of the component.
            region: a part of the board in place of a component.
            light: merge the frames under this light; by default that of most frames of the run.
            px_per_mm: resolution; by default that of the cameras.
            min_coverage: omit frames that show a smaller share.
        """
        query = {
            "component": component,
            "region": None if region is None else ",".join(f"{v!r}" for v in _box("merged", region)),
            "light": light,
            "px_per_mm": px_per_mm,
            "min_coverage": min_coverage,
        }
        path = self._path("merged")
        listing = checked(MergedListReply, self._client.get(path, **query), self._client.url(path))

        def picture(facts: MergedReply) -> MergedPicture:
            def load(sigma: bool) -> NDArray[Any]:
                return self._array(f"{facts.url}&format=npy{'&sigma=true' if sigma else ''}", None)

            return MergedPicture(facts, load)

        return tuple(picture(facts) for facts in listing.pictures)

    def mosaics(self) -> tuple[MosaicReply, ...]:
        """Return the pictures of the whole board that the station offers: by light, by exposure, and merged."""
        path = self._path("mosaics")
        return tuple(checked(MosaicListReply, self._client.get(path), self._client.url(path)).mosaics)

    def save_mosaic(
        self, name: str, path: str | Path, *, region: Box | None = None, px_per_mm: float | None = None
    ) -> None:
        """Write a picture of the whole board, or of a region, to a file: tiled, pyramidal TIFF.

        Args:
            name: name of one of `mosaics`.
            path: the file, which is complete or unchanged.
            region: a part of the board.
            px_per_mm: resolution; by default that of the cameras.
        """
        target = require_path("save_mosaic", "path", path)
        corners = (
            {} if region is None else dict(zip(("x0", "y0", "x1", "y1"), _box("save_mosaic", region), strict=True))
        )
        address = self._path(f"mosaics/{quote(require_text('save_mosaic', 'name', name), safe='')}.tif")
        # Calls at the same time write to several drafts, so that they do not mix them.
        part = target.with_name(f".{target.name}.{token_hex(4)}.part")
        try:
            with self._client.opened(address, px_per_mm=px_per_mm, **corners) as reply, part.open("wb") as file:
                shutil.copyfileobj(reply, file)
                length = reply.headers.get("Content-Length")
            # A reply that is read piece by piece ends without an error where its connection ends.
            if length is not None and int(length) != part.stat().st_size:
                raise unusable_reply(self._client.url(address), "a file that ends early")
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)

    def heights(self) -> Mapping[str, HeightEntry]:
        """Return the heights of the components above the board, by address.

        Raises:
            StateError: the run has no CAD mapping, or the calibration no working distance.
            GoneError: they were not measured while the frames were there.
        """
        path = self._path("heights")
        return checked(HeightList, self._client.get(path), self._client.url(path)).heights

    def timeline(self) -> Timeline:
        """Return the times of the steps of the run: frames, links, result, and what followed."""
        path = self._path("timeline")
        return checked(Timeline, self._client.get(path), self._client.url(path))

    def identity(self, timeout_s: float = 0.0) -> IdentityDocument:
        """Return which board the run shows: the ids that were armed, read and reported, and whether they agree.

        Args:
            timeout_s: longest wait for the codes, 0 to 60; before they are read, `state` is `pending`.
        """
        require_number("identity", "timeout_s", timeout_s, 0.0, 60.0)
        path = self._path("identity")
        return checked(IdentityDocument, self._client.get(path, timeout=timeout_s), self._client.url(path))

    def report_next_machine(self, board_id: str, machine: str = "") -> IdentityDocument:
        """Report the id that the next machine of the line has read of this board; return the ids compared."""
        path = self._path("identity/next-machine")
        fields = {"board_id": require_text("report_next_machine", "board_id", board_id), "machine": machine}
        return checked(IdentityDocument, self._client.put_document(path, fields), self._client.url(path))

    def decide(self, choice: Choice, name: str, reason: str) -> None:
        """Keep what a person has decided about the run: `film-again`, or `use` its pictures despite the verdict.

        Args:
            choice: the decision; the verdict stays as it is.
            name: name of the person.
            reason: why.
        """
        given = {"choice": choice, "name": name, "reason": reason}
        for field_name, value in given.items():
            require_text("decide", field_name, value)
        self._client.put_document(self._path("decision"), given)

    def pin(self) -> None:
        """Keep the run until it is unpinned: result and record, and its frames as a recording if they are there."""
        self._client.put(self._path("pin"))

    def unpin(self) -> None:
        """Remove the pin; the run is then deleted like other runs."""
        self._client.delete(self._path("pin"))

    def hold(self, holder: str, purpose: str = "") -> LeaseStatus:
        """Keep the frames of the run in memory until the hold expires or ends; a repeated call renews the hold.

        Raises:
            GoneError: the station no longer keeps the frames.
        """
        path = self._path("hold")
        return checked(LeaseStatus, self._client.put(path, holder=holder, purpose=purpose), self._client.url(path))

    def end_hold(self, holder: str) -> None:
        """End the hold of `hold`; the frames stay as long as the station has memory for them."""
        self._client.delete(self._path("hold"), holder=require_text("end_hold", "holder", holder))

    def release(self, holder: str | None = None) -> None:
        """Give up the frames of the run, so that the next board can use their memory; the result stays.

        Args:
            holder: the name under which the caller held the run; None if it did not.

        Raises:
            StateError: another caller holds the run.
        """
        query = f"?holder={quote(holder, safe='')}" if holder else ""
        self._client.post(self._path(f"release{query}"))

    def check_board_type(self, name: str | None = None) -> BoardCheck:
        """Lay a board type of the station, by default that of the run, over the run's pictures; takes seconds."""
        path = self._path("board-check")
        return checked(BoardCheck, self._client.get(path, board_type=name), self._client.url(path))

    def board_check_picture(self, name: str | None = None) -> bytes:
        """Return the picture of `check_board_type` as JPEG: the components of the board type over the board."""
        return self._client.content(self._path("board-check/picture"), board_type=name)

    def correct_board_type(self, name: str, revision: str | None = None) -> BoardType:
        """Store the correction that `check_board_type` proposes, as a draft of the board type."""
        path = f"/board-types/{quote(name, safe='')}/correct"
        fields = {"run": self.id, "revision": revision}
        return checked(BoardType, self._client.post(path, **fields), self._client.url(path))

    def _path(self, rest: str) -> str:
        return f"/runs/{quote(self.id, safe='')}/{rest}"

    def _array(self, path: str, format: Literal["npy"] | None = "npy", **query: Any) -> NDArray[Any]:
        content = self._client.content(path, format=format, **query)
        try:
            found = np.load(io.BytesIO(content), allow_pickle=False)
        except (ValueError, EOFError) as error:
            raise unusable_reply(self._client.url(path), f"{len(content)} bytes that are no array") from error
        return np.asarray(found)

    def _image(self, view: ViewReply) -> ComponentImage:
        def load() -> NDArray[Any]:
            return self._client.picture(view.url)[1]

        fields: dict[str, Any] = {name: getattr(view, name) for name in FIELDS}
        fields |= {"crop_from_cad": view.crop_from_cad, "image_from_crop": view.image_from_crop}
        covariance = None if view.covariance_px2 is None else np.array(view.covariance_px2)
        return ComponentImage(**fields, covariance_px2=covariance, _load=load)


def _box(function: str, region: object) -> Box:
    """Return a region as four numbers; raise InputError if it is none."""
    values = tuple(region) if isinstance(region, Iterable) and not isinstance(region, str) else ()
    if len(values) != 4:
        raise InputError.field(function, "region", region, "four numbers: x0, y0, x1, y1")
    x0, y0, x1, y1 = (require_number(function, "region", v, -1e6, 1e6) for v in values)
    return x0, y0, x1, y1
