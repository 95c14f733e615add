"""What the cameras at the places of the array are, also of one that is gone, and after a restart."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from vaoi_station.acquisition.process import messages
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.store.documents import KeyedTexts

_KEY = "cameras"


class CameraAtPlace(BaseModel):
    """The real camera that was last connected at a place; empty texts if none was."""

    model_config = ConfigDict(frozen=True)

    serial: str = ""
    model: str = ""
    address: str = ""
    named: str = ""
    """Address by which station.toml named the place then; empty if it gave the serial number."""


_STORED = TypeAdapter(tuple[CameraAtPlace, ...])


class CameraPlaces:
    """The cameras by place. Used by the coordinator's thread only; the database keeps them over restarts."""

    def __init__(self, documents: KeyedTexts | None, count: int) -> None:
        """Read what is stored; `documents` is None if nothing is stored."""
        self._documents = documents
        stored = documents.get(_KEY) if documents is not None else None
        try:
            known = () if stored is None else _STORED.validate_json(stored)
        except ValidationError:  # of another version
            known = ()
        self.cameras = known if len(known) == count else (CameraAtPlace(),) * count

    def note(self, health: messages.Health, configured: Sequence[CameraConfig]) -> None:
        """Take what connected cameras say that they are."""
        seen = tuple(
            CameraAtPlace(serial=camera.serial, model=camera.model, address=camera.address, named=config.address or "")
            if camera.connected and camera.serial
            else known
            for camera, config, known in zip(health.cameras, configured, self.cameras, strict=True)
        )
        if seen != self.cameras:
            self.cameras = seen
            if self._documents is not None:
                self._documents.set(_KEY, _STORED.dump_json(seen).decode())

    def to_open(self, config: StationConfig) -> StationConfig:
        """Return a configuration in which cameras named by address also have the serial number last seen there.

        Another camera at that address is then refused: it would film with the calibration of its predecessor.
        """
        serials: dict[str | None, str | None] = {place.named: place.serial for place in self.cameras if place.named}
        cameras = [c.model_copy(update={"serial": serials.get(c.address, c.serial)}) for c in config.cameras]
        return config.model_copy(update={"cameras": tuple(cameras)})
