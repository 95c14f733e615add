"""A camera in the place of another: which cameras the network has, their addresses, the exchange, its confirmation.

station.toml and the calibration are replaced, each with a copy of the file before, and are in force at once: the
station is not restarted. All of it needs the scope admin.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from vaoi_station.acquisition.cameras.aravis.discovery import (
    FoundCamera,
    find,
    free_address,
    require_free,
    search_all,
    set_address,
)
from vaoi_station.acquisition.cameras.aravis.network import Control
from vaoi_station.api.access import CHANGED
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import Camera, rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.settings import SettingChange, SettingsFile
from vaoi_station.api.setup.station_files import StationFiles, content_of, replace_with_backup, require_writable
from vaoi_station.calibration.exchanged_camera import without_place
from vaoi_station.config import CameraConfig
from vaoi_station.errors import NotFoundError, StateError, VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.files.documents import parse_toml, text_of, write_bytes
from vaoi_station.model import Calibration, Strict
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import CameraStatus
from vaoi_station.store.documents import digest_of

_log = logging.getLogger(__name__)
Serial = Annotated[str, Field(min_length=1, max_length=64, description="Serial number, as on the label of the camera.")]
_CALIBRATE = "Otherwise enter it in station.toml, restart the station, and calibrate the whole array."


class NetworkCamera(BaseModel):
    """A camera that answers on a network port of the station."""

    serial: str
    model: str
    maker: str
    address: str = Field(description="IP address; empty for a USB3 camera.")
    mac: str = Field(description="Hardware address; empty for a USB3 camera.")
    interface: str = Field(description="Network port of the station on which it answers, or its place at USB.")
    reachable: bool = Field(description="Whether its address is of the network of this port; else it needs another.")
    in_use: bool = Field(description="Whether a program controls it, of this station or another one.")
    place: str | None = Field(default=None, description="Name of its place in station.toml; absent if it has none.")


class GonePlace(BaseModel):
    """A place of the array whose camera does not answer."""

    camera: int
    name: str
    serial: str
    model: str = Field(description="Model that a camera in its place must have; empty if it is not known.")
    candidates: list[str] = Field(
        description="Serial numbers of cameras of this model that have no place and are free."
    )


class CameraSearch(BaseModel):
    """The GigE cameras that answer a broadcast now, also those of a foreign network, and the USB3 cameras."""

    found: list[NetworkCamera]
    gone: list[GonePlace]


class AddressRequest(Strict):
    """The address that a camera is to have, now and after every power-on."""

    serial: Serial
    address: str | None = Field(
        default=None, max_length=15, description="IPv4 address; absent: a free one in the network of the port."
    )


class ExchangeRequest(Strict):
    """The camera that is to have the place of one that is gone."""

    serial: Serial
    address: str | None = Field(default=None, max_length=15, description="Give it this address before.")


class Exchanged(BaseModel):
    """A camera has the place of another; the station opens it."""

    camera: int
    name: str
    serial: str
    before: str
    address: str
    settings_backup: str | None = Field(default=None, description="Name of the copy of station.toml.")
    calibration_backup: str | None = Field(default=None, description="Name of the copy of the calibration.")


class Confirmed(BaseModel):
    """The calibration of exchanged cameras is in force."""

    cameras: list[int]
    sigma_px: float = Field(description="Largest standard deviation of their places, px.")
    lines: list[str] = Field(description="What was found, one line for each camera.")
    backup: str | None = None


def router(services: Services, files: StationFiles) -> APIRouter:
    """Create the routes."""
    routes, exchange = rest_router(prefix="/cameras", tags=["setup"]), CameraExchange(services.coordinator, files)
    # A search broadcasts, and takes a second; exchanges are made one after the other.
    searching, changing = ThreadLimit(1), ThreadLimit(1)

    @routes.get("/search")
    async def search_cameras() -> CameraSearch:
        """Search the network ports of the station for cameras, and places whose camera is gone. It takes a second."""
        return await searching.ask(exchange.search)

    @routes.post("/search/address")
    async def set_camera_address(wanted: AddressRequest) -> NetworkCamera:
        """Give a camera an address, now and after every power-on.

        409 `address-taken`: another device has it; 503 `camera-absent`, `camera-in-use`, `address-refused`.
        """
        return await changing.ask(exchange.set_address, wanted)

    @routes.post("/{camera}/exchange")
    async def exchange_camera(request: Request, camera: Camera, wanted: ExchangeRequest) -> Exchanged:
        """Put a camera of the same model in the place of one that is gone, with its settings, without a restart.

        Its serial number is written to station.toml, and the calibration does not know any more where it hangs: every
        run is degraded until that is confirmed. 409: `line-armed`; `camera-connected`: the one before answers;
        `serial-used`; `camera-model`: another model, or it is not known; `restart-due`; `settings-read-only`.
        """
        made = await changing.ask(exchange.exchange, camera, wanted)
        request.scope["state"][CHANGED] = [f"cameras.{camera}.serial"]
        return made

    @routes.post("/{camera}/exchange/confirm")
    async def confirm_camera(camera: Camera) -> Confirmed:
        """Put the calibration of exchanged cameras in force, as the boards since then show it; all others are held.

        `exchange` of `GET calibration` has it before. 409 `line-armed`, `restart-due`, `settings-read-only`; 422: the
        boards do not suffice, another camera has moved as well, or this one sees otherwise than its predecessor.
        """
        return await changing.ask(exchange.confirm, camera)

    return routes


class CameraExchange:
    """Exchanges cameras of a station. Methods may be called from any thread, one at a time."""

    def __init__(
        self,
        coordinator: StationCoordinator,
        files: StationFiles,
        broadcast: Callable[[], tuple[FoundCamera, ...]] = search_all,
    ) -> None:
        self._coordinator, self._files, self._broadcast = coordinator, files, broadcast
        self._lock = threading.Lock()

    def search(self) -> CameraSearch:
        """Return the cameras that answer, and the places whose camera is gone."""
        found, places = self._broadcast(), self._places()
        shown = [self._shown(camera, places) for camera in found]
        there = {camera.place for camera in shown}
        gone = [
            GonePlace(
                camera=k,
                name=config.name,
                serial=config.serial or status.serial,
                model=self._model_of(k, places, found),
                candidates=[
                    camera.serial
                    for camera in shown
                    if camera.place is None and not camera.in_use and camera.model == self._model_of(k, places, found)
                ],
            )
            for k, (config, status) in enumerate(places)
            if config.backend == "aravis" and not status.connected and config.name not in there
        ]
        return CameraSearch(found=shown, gone=gone)

    def set_address(self, wanted: AddressRequest) -> NetworkCamera:
        """Give a camera an address; it is free, or taken by the station itself, which then refuses."""
        with self._lock:
            found = self._broadcast()
            camera = find(wanted.serial, found)
            address = wanted.address or free_address(camera, (), self._used(found, camera))
            set_address(camera, address)
            _log.info("camera %s has the address %s in place of %s", camera.serial, address, camera.address)
            return self._shown(find(wanted.serial, self._broadcast()), self._places())

    def exchange(self, camera: int, wanted: ExchangeRequest) -> Exchanged:
        """Put a camera in the place of one that is gone. If a step fails, files and station are as before."""
        with self._lock:
            self._coordinator.require_disarmed()
            places = self._places()
            config, status = self._gone(camera, places)
            self._refuse_used(wanted.serial, places)
            found, before = self._broadcast(), config.serial or status.serial
            for other in found:
                if _place_of(other, places) == config.name:
                    raise _connected(config.name, other.serial)
            new = find(wanted.serial, found)
            self._refuse_model(new, camera, places, found)
            require_free(new)
            calibration = self._calibration_in_force()
            require_writable(self._files.path)
            if calibration is not None:
                require_writable(self._files.config.calibration)
            new = self._addressed(new, wanted.address, config.address or status.address, found)
            saved = self._settings_saved(camera, config, new.serial)
            backup = None
            try:
                if calibration is not None:
                    calibration = without_place(calibration, camera)
                    backup = replace_with_backup(self._files.config.calibration, content_of(calibration))
                self._coordinator.exchange_camera(camera, new.serial, new.address, calibration)
            except VaoiError:
                self._restore(saved, backup)
                raise
            self._files.config = self._files.config.with_serial(camera, new.serial)
            _log.info("camera %s: %s is in the place of %s", config.name, new.serial, before or "an unknown one")
            return Exchanged(
                camera=camera,
                name=config.name,
                serial=new.serial,
                before=before,
                address=new.address,
                settings_backup=saved,
                calibration_backup=backup,
            )

    def confirm(self, camera: int) -> Confirmed:
        """Put the calibration in force that the boards since the exchange show."""
        with self._lock:
            self._coordinator.require_disarmed()
            if self._calibration_in_force() is None:
                raise StateError("The array is not calibrated.", action="Calibrate it.", code="no-calibration")
            proposal = self._coordinator.exchange_proposal()
            if camera not in proposal.corrected:
                raise StateError(f"Camera {camera} is calibrated.", code="nothing-exchanged")
            path = self._files.config.calibration
            backup = replace_with_backup(path, content_of(proposal.calibration))
            try:
                self._coordinator.use_calibration(proposal.calibration)
            except VaoiError:
                self._undo(path, backup)
                raise
            sigma_px = max(float(proposal.found.sigma_px[i].max()) for i in proposal.corrected)
            lines = proposal.lines()
            _log.info("the calibration of exchanged cameras was confirmed: %s", "; ".join(lines))
            return Confirmed(cameras=list(proposal.corrected), sigma_px=round(sigma_px, 4), lines=lines, backup=backup)

    def _places(self) -> list[tuple[CameraConfig, CameraStatus]]:
        return list(zip(self._files.config.cameras, self._coordinator.snapshot().cameras, strict=True))

    def _shown(self, camera: FoundCamera, places: list[tuple[CameraConfig, CameraStatus]]) -> NetworkCamera:
        control = camera.control
        return NetworkCamera(
            serial=camera.serial,
            model=camera.model,
            maker=camera.maker,
            address=camera.address,
            mac=camera.mac,
            interface=camera.interface,
            reachable=control is not Control.ABSENT,
            in_use=control is Control.CONTROLLED,
            place=_place_of(camera, places),
        )

    def _gone(self, camera: int, places: list[tuple[CameraConfig, CameraStatus]]) -> tuple[CameraConfig, CameraStatus]:
        if camera >= len(places):
            raise NotFoundError(f"There is no camera {camera}; the station has {len(places)}.")
        config, status = places[camera]
        if config.backend != "aravis":
            raise StateError(
                f"Camera {config.name} is no real one (backend {config.backend!r}).",
                action="Only real cameras can be exchanged.",
                code="camera-not-real",
            )
        if status.connected:
            raise _connected(config.name, status.serial)
        return config, status

    def _refuse_used(self, serial: str, places: list[tuple[CameraConfig, CameraStatus]]) -> None:
        for config, status in places:
            if serial == (config.serial or status.serial):
                raise StateError(
                    f"The camera {serial} is that of place {config.name}; one camera cannot stand at two places.",
                    action="Give the serial number on the label of the new camera.",
                    code="serial-used",
                )

    def _model_of(
        self, camera: int, places: list[tuple[CameraConfig, CameraStatus]], found: tuple[FoundCamera, ...]
    ) -> str:
        """Return the model that a camera at a place must have; empty if it is not known.

        A station that never saw its camera goes by the others, if all of them are of one model.
        """
        others = {status.model for _, status in places if status.model}
        others |= {other.model for other in found if _place_of(other, places) is not None}
        return places[camera][1].model or (others.pop() if len(others) == 1 else "")

    def _refuse_model(
        self,
        new: FoundCamera,
        camera: int,
        places: list[tuple[CameraConfig, CameraStatus]],
        found: tuple[FoundCamera, ...],
    ) -> None:
        wanted, name = self._model_of(camera, places, found), places[camera][0].name
        if wanted == new.model and wanted:
            return
        what = (
            f"must be a {wanted}, as the one before, but {new.serial} is a {new.model}"
            if wanted
            else f"was never seen by this station, so it is not known whether {new.serial}, a {new.model}, is alike"
        )
        raise StateError(
            f"Camera {name} {what}: settings, lens and calibration may not fit.",
            action=f"Use a camera of the same model. {_CALIBRATE}",
            code="camera-model",
        )

    def _addressed(
        self, new: FoundCamera, wanted: str | None, before: str, found: tuple[FoundCamera, ...]
    ) -> FoundCamera:
        """Return the camera with an address at which the station reaches it: that of its predecessor, if it is free."""
        if wanted is None and new.in_network:
            return new
        used = self._used(found, new) - {before}
        address = wanted or free_address(new, [before] if before else (), used)
        set_address(new, address)
        return find(new.serial, self._broadcast())

    def _used(self, found: tuple[FoundCamera, ...], camera: FoundCamera) -> set[str]:
        """Return the addresses that others have: that answer, or that are absent now and will come back."""
        places = {address for config, status in self._places() for address in (config.address, status.address)}
        others = {other.address for other in found if other != camera}
        return {address for address in places if address} | others

    def _calibration_in_force(self) -> Calibration | None:
        """Return the calibration in force; None if the array is not calibrated. `StateError`: the file is another."""
        path = self._files.config.calibration
        if not path.exists():
            return None
        calibration = read_calibration(path, self._files.config.heads)
        if digest_of(calibration.model_dump_json()) != self._coordinator.calibration().digest:
            raise _restart_due(path.name)
        return calibration

    def _settings_saved(self, camera: int, config: CameraConfig, serial: str) -> str | None:
        """Write the serial number to station.toml; return the name of the copy."""
        changes = [SettingChange(key=f"cameras.{camera}.serial", value=serial)]
        if config.address is not None:
            changes.append(SettingChange(key=f"cameras.{camera}.address"))

        def require(content: bytes) -> None:
            path = self._files.path
            data = parse_toml(text_of(content, path), path)
            names = [entry.get("name") for entry in data.get("cameras", ()) if isinstance(entry, dict)]
            if names != [place.name for place in self._files.config.cameras]:
                raise _restart_due(path.name)

        return SettingsFile(self._files).save(changes, require).backup

    def _restore(self, settings: str | None, calibration: str | None) -> None:
        self._undo(self._files.path, settings)
        if calibration is not None:
            self._undo(self._files.config.calibration, calibration)

    @staticmethod
    def _undo(path: Path, backup: str | None) -> None:
        """Put the copy of a file back; the log says if that fails too."""
        if backup is not None:
            try:
                write_bytes(path.resolve(), path.resolve().with_name(backup).read_bytes())
            except (OSError, VaoiError):
                _log.exception("%s could not be restored from its copy %s", path, backup)


def _place_of(camera: FoundCamera, places: list[tuple[CameraConfig, CameraStatus]]) -> str | None:
    """Return the name of the place of a camera: by the serial number, or the address where that is not known."""
    for config, status in places:
        known = config.serial or status.serial
        if camera.serial == known if known else camera.address == config.address:
            return config.name
    return None


def _connected(name: str, serial: str) -> StateError:
    return StateError(
        f"The camera {serial} of place {name} answers.",
        action="Unplug the camera that is to be replaced, wait some seconds, then try again.",
        code="camera-connected",
    )


def _restart_due(name: str) -> StateError:
    return StateError(
        f"{name} was changed since the start of the station, and is not in force yet.",
        action="Restart the station, then try again.",
        code="restart-due",
    )
