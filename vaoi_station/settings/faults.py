"""All faults of the data of a station.toml at once, each with its place."""

from __future__ import annotations

import copy
from contextlib import suppress
from difflib import get_close_matches
from typing import Any, NamedTuple, TypeVar, cast

from pydantic import BaseModel, TypeAdapter, ValidationError

from vaoi_station.config import TABLE_OF, CameraConfig, ControllerConfig, StationConfig, conflicts
from vaoi_station.files.documents import UNKNOWN_KEY, Place, faults_of, key_at
from vaoi_station.line_config import Hermes, Line, Smema
from vaoi_station.settings.keys import keys

T = TypeVar("T", bound=BaseModel)
_VALUES = {
    key: TypeAdapter[Any](cast("Any", field.rebuild_annotation())) for key, field in StationConfig.model_fields.items()
}


class Fault(NamedTuple):
    """What is wrong in a station.toml."""

    place: Place
    """Empty if tables contradict each other."""
    text: str

    def __str__(self) -> str:
        return f"{key_at(self.place)}: {self.text}" if self.place else self.text


def examine(data: dict[str, Any]) -> tuple[list[Fault], dict[str, Any]]:
    """Return the faults of a file, and the values of the top-level keys that are valid, defaults included."""
    found = _faults(StationConfig, data)
    given = data.get("cameras")
    cameras = given if isinstance(given, list) else []
    # Cameras are checked one by one, so that one faulty camera does not prevent the check of the others.
    for index, camera in enumerate(cameras):
        if isinstance(camera, dict):
            found |= {("cameras", index, *place): text for place, text in _faults(CameraConfig, camera).items()}
    wrong = {place[0] for place in found if place}
    found.pop((), None)  # a conflict between tables: all of them follow here
    valid = {
        key: _VALUES[key].validate_python(data[key]) if key in data else field.get_default()
        for key, field in StationConfig.model_fields.items()
        if key not in wrong
    }
    sound = [camera for c in cameras if (camera := _known(CameraConfig, c)) is not None]
    controller = _known(ControllerConfig, data.get("controller", {}))
    line, hermes = _known(Line, data.get("line")), _known(Hermes, data.get("hermes"))
    smema = _known(Smema, data.get("smema"))
    between = [*conflicts(sound, controller, data.keys() & set(TABLE_OF.values()), line, hermes, smema)]
    if between:
        # It is not clear which devices are meant, so the inputs of simulated or replayed devices are not checked.
        valid.pop("controller", None)
    return [
        *(Fault(place, text + _meant(place, text)) for place, text in found.items()),
        *(Fault((), text) for text in between),
    ], valid


def _meant(place: Place, fault: str) -> str:
    """Return the known key that an unknown one resembles, as the end of the text of its fault; empty for all others."""
    if not fault.startswith(UNKNOWN_KEY):
        return ""
    table = "".join("[]" if isinstance(part, int) else f".{part}" for part in place[:-1]).lstrip(".")
    prefix = f"{table}." if table else ""
    below = (key.key.removeprefix(prefix) for key in keys() if key.key.startswith(prefix))
    close = get_close_matches(str(place[-1]), {name.partition(".")[0].removesuffix("[]") for name in below}, n=1)
    return f", perhaps {close[0]!r} is meant" if close else ""


def _faults(model: type[BaseModel], data: dict[str, Any]) -> dict[Place, str]:
    """Return every fault of a table and its place.

    Rules that compare several keys run only if all keys are valid. Therefore faulty keys are removed and the rest is
    validated again, until no new fault is found.
    """
    rest, found = copy.deepcopy(data), dict[Place, str]()
    while True:
        try:
            model.model_validate(rest)
        except ValidationError as error:
            new = {place: text for place, text in faults_of(error) if place not in found}
            # A required key that was removed is now missing; that is no new fault.
            taken_out = [place for place in new if place and _take_out(rest, place)]
            found |= new
            if taken_out:
                continue
        return found


def _take_out(data: Any, place: Place) -> bool:
    """Remove the innermost key of a place from its table; return False if the place is not in the data."""
    owner, last = None, None
    for key in place:
        if isinstance(data, dict) and key in data:
            owner, last = data, key
        elif not isinstance(data, list) or not isinstance(key, int) or key >= len(data):
            break
        data = data[key]
    if owner is None:
        return False
    del owner[last]
    return True


def _known(model: type[T], data: Any) -> T | None:
    """Return the table without its unknown keys, as a validated model; None if its other keys are not valid."""
    if isinstance(data, dict):
        with suppress(ValidationError):
            return model.model_validate({key: value for key, value in data.items() if key in model.model_fields})
    return None
