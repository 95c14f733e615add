"""A running station, used over REST (docs/rest.md): its runs, and component images as numpy arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Unpack
from urllib.parse import quote, urlsplit

import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.report import BoardCheck
from vaoi_station.demo.client import Client, unusable_reply
from vaoi_station.errors import InputError
from vaoi_station.files.caller_credentials import caller_credentials
from vaoi_station.library.arguments import require_number, require_path, require_text, require_whole
from vaoi_station.library.board_data import ImportChoices, StationImport
from vaoi_station.library.component_images import FIELDS, ComponentImage, ComponentImages
from vaoi_station.library.picture_stream import ComponentPictures, read_pictures
from vaoi_station.library.replies import (
    ComponentListReply,
    ComponentReply,
    RunIdReply,
    RunListReply,
    ViewReply,
    checked,
)
from vaoi_station.library.stitched_run import component_height
from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.rendering.request import ImageOptions, ImageRequest


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
        path = f"/runs/{quote(self.id)}/matrices"
        return checked(Stitch, self._client.get(path), self._client.url(path))

    @property
    def status(self) -> Status:
        """The verdict of the run: ok, degraded or failed."""
        return self.result.status

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for a verdict other than ok, in sentences."""
        return self.result.reasons

    @cached_property
    def refs(self) -> tuple[str, ...]:
        """Addresses of all components of the board type."""
        path = f"/runs/{quote(self.id)}/components"
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
        path = f"/runs/{quote(self.id)}/components/{quote(ref)}"
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
        path = f"/runs/{quote(self.id)}/images"
        with self._client.opened(path, component=components or None, format="raw", **wanted) as reply:
            yield from read_pictures(reply, self._client.url(path))

    def hold(self, holder: str, purpose: str = "") -> None:
        """Keep the frames of the run in memory until the hold expires or ends; a repeated call renews the hold.

        Raises:
            GoneError: the station no longer keeps the frames.
        """
        self._client.put(f"/runs/{quote(self.id)}/hold", holder=holder, purpose=purpose)

    def release(self, holder: str | None = None) -> None:
        """Give up the frames of the run, so that the next board can use their memory; the result stays.

        Args:
            holder: the name under which the caller held the run; None if it did not.

        Raises:
            StateError: another caller holds the run.
        """
        query = f"?holder={quote(holder, safe='')}" if holder else ""
        self._client.post(f"/runs/{quote(self.id)}/release{query}")

    def check_board_type(self, name: str | None = None) -> BoardCheck:
        """Lay a board type of the station, by default that of the run, over the run's pictures; takes seconds."""
        path = f"/runs/{quote(self.id, safe='')}/board-check"
        return checked(BoardCheck, self._client.get(path, board_type=name), self._client.url(path))

    def correct_board_type(self, name: str, revision: str | None = None) -> BoardType:
        """Store the correction that `check_board_type` proposes, as a draft of the board type."""
        path = f"/board-types/{quote(name, safe='')}/correct"
        fields = {"run": self.id, "revision": revision}
        return checked(BoardType, self._client.post(path, **fields), self._client.url(path))

    def _image(self, view: ViewReply) -> ComponentImage:
        def load() -> NDArray[Any]:
            return self._client.picture(view.url)[1]

        fields: dict[str, Any] = {name: getattr(view, name) for name in FIELDS}
        fields |= {"crop_from_cad": view.crop_from_cad, "image_from_crop": view.image_from_crop}
        covariance = None if view.covariance_px2 is None else np.array(view.covariance_px2)
        return ComponentImage(**fields, covariance_px2=covariance, _load=load)


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
        credentials = caller_credentials(_path("key_file", key_file), _path("ca", ca), key=key)
        self._client = Client(checked_address(address), credentials)

    def snapshot(self) -> dict[str, Any]:
        """Return the present state of the station as `GET station` gives it."""
        reply = self._client.get("/station")
        if reply is None:
            raise unusable_reply(self._client.url("/station"), "no content")
        return dict(reply)

    def arm(
        self,
        board_type: str,
        *,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
    ) -> dict[str, Any]:
        """Arm the line: film every board from now on, or only the next `runs` boards. Return the station's state.

        Args:
            board_type: name of the board type.
            board_id: the caller's id of the next board; it is repeated in the result.
            job_id: the caller's id of the job, likewise.
            runs: number of runs after which the line is disarmed; None: it stays armed.
            allow_lost_cameras: arm although cameras are missing.

        Raises:
            NotFoundError: the station has no such board type.
            StateError: the line cannot be armed in the present state.
            BusyError: all memory is in use, or a camera is missing.
        """
        fields = {
            "board_type": require_text("arm", "board_type", board_type),
            "board_id": board_id,
            "job_id": job_id,
            "runs": None if runs is None else require_whole("arm", "runs", runs, 1, 1_000_000),
            "allow_lost_cameras": allow_lost_cameras or None,
        }
        return self._command("/station/arm", {k: v for k, v in fields.items() if v is not None})

    def disarm(self) -> dict[str, Any]:
        """Disarm the line: film no further board. Return the station's state."""
        return self._command("/station/disarm", {})

    def events(self, after: int) -> Iterator[dict[str, Any]]:
        """Yield events numbered above `after`, and heartbeats, as they happen, until the station ends.

        `last_event` of `snapshot` is the number of the newest one.
        """
        yield from self._client.messages(require_whole("events", "after", after, 0, 2**53))

    def runs(self, limit: int = 50) -> list[dict[str, Any]]:
        """Return summaries of the newest runs, newest first."""
        require_whole("runs", "limit", limit, 1, 1_000_000)
        return checked(RunListReply, self._client.get("/runs", limit=limit), self._client.url("/runs")).runs

    def run(self, run_id: str = "latest") -> StationRun:
        """Return a run by its id, by default the one that finished last."""
        path = f"/runs/{quote(require_text('run', 'run_id', run_id), safe='')}"
        return self._run(self._client.get(path), path)

    def wait_for_run(self, after: str | None = None, timeout_s: float = 30.0) -> StationRun | None:
        """Wait for the next finished run; return None if no run finishes in time.

        Args:
            after: id of the last run that the caller knows, so that no run is missed. By default the call returns the
                next run to finish.
            timeout_s: 0 to 60.
        """
        if after is not None:
            require_text("wait_for_run", "after", after)
        require_number("wait_for_run", "timeout_s", timeout_s, 0.0, 60.0)
        summary = self._client.get("/runs/next", after=after, timeout=timeout_s)
        return None if summary is None else self._run(summary, "/runs/next")

    def upload_board_data(
        self, path: str | Path, side: Literal["top", "bottom"] = "top", **choices: Unpack[ImportChoices]
    ) -> StationImport:
        """Send a file of a CAD system or placement machine to the station, which shows what it would make of it.

        Nothing is stored until `confirm` of the reply. Options are those of `import_board_data`.
        """
        return StationImport.upload(self._client, path, {"side": side, **choices})

    def _command(self, path: str, fields: dict[str, Any]) -> dict[str, Any]:
        reply = self._client.post(path, **fields)
        if reply is None:
            raise unusable_reply(self._client.url(path), "no content")
        return dict(reply)

    def _run(self, summary: Any, path: str) -> StationRun:
        return StationRun(checked(RunIdReply, summary, self._client.url(path)).id, dict(summary), self._client)


def connect(
    address: str = "http://127.0.0.1:8350",
    *,
    key: str | None = None,
    key_file: str | Path | None = None,
    ca: str | Path | None = None,
) -> Station:
    """Connect to a running station.

    Args:
        address: `http://HOST:PORT`, or `https://HOST:PORT` if the station has a certificate.
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


def _path(name: str, value: str | Path | None) -> Path | None:
    return None if value is None else require_path("connect", name, value)


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
