"""What the cameras at the places of the array are, also of one that is gone, and after a restart."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from vaoi_station.acquisition.process import messages
from vaoi_station.store.documents import KeyedTexts

_KEY = "cameras"


class CameraAtPlace(BaseModel):
    """The real camera that was last connected at a place; empty texts if none was."""

    model_config = ConfigDict(frozen=True)

    serial: str = ""
    model: str = ""
    address: str = ""


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

    def note(self, health: messages.Health) -> None:
        """Take what connected cameras say that they are."""
        seen = tuple(
            CameraAtPlace(serial=camera.serial, model=camera.model, address=camera.address)
            if camera.connected and camera.serial
            else known
            for camera, known in zip(health.cameras, self.cameras, strict=True)
        )
        if seen != self.cameras:
            self.cameras = seen
            if self._documents is not None:
                self._documents.set(_KEY, _STORED.dump_json(seen).decode())
