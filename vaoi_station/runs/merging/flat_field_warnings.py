"""Warnings of the station about its flat fields: they do not fit cameras or lights, or they have expired."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from vaoi_station.config import StationConfig
from vaoi_station.errors import VaoiError
from vaoi_station.model import Reason
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.flat_fields import EXPIRED_DAYS, changed_ns

_AGAIN = "Film a white target and darkness, and run 'vaoi flatfield' (docs/how-to/photometry.md)."


def flat_field_warnings(config: StationConfig, armed: Sequence[str] = ()) -> tuple[Reason, ...]:
    """Return a warning if the flat fields of station.toml cannot be used or have expired, else none.

    `armed` are the lights of the rows of the armed board type; without them those of station.toml count.
    """
    if config.flat_fields is None:
        return ()
    fields = _peek(config.flat_fields, changed_ns(config.flat_fields))
    try:
        if isinstance(fields, VaoiError):
            raise fields
        # Where no light is known, the fields are not checked against any.
        lights = armed or config.known_lights or fields.named_lights
        fields.check([camera.head for camera in config.cameras], lights)
    except VaoiError as error:
        return (Reason(code="flat-fields-unfit", message=error.message, action=error.action or _AGAIN),)
    days = fields.age_days(datetime.now(UTC))
    if days is None or days <= EXPIRED_DAYS:
        return ()
    message = (
        f"{config.flat_fields}: the flat fields are {days:.0f} days old and expire after {EXPIRED_DAYS}: lamps age, "
        "and dust settles on lenses."
    )
    return (Reason(code="flat-fields-expired", message=message, action=_AGAIN),)


@lru_cache(maxsize=2)
def _peek(directory: Path, _changed_ns: int) -> FlatFields | VaoiError:
    """Read the document once for each of its versions; an error is a value, because it is kept as well."""
    try:
        return FlatFields.peek(directory)
    except VaoiError as error:
        return error
