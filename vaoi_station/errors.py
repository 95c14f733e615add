"""Errors say whose fault it is, and what to do.

Every error that leaves a room of this house is a `VaoiError`. Its class says who can mend it (the
person who gave the input, a device, the present state of the station, or we), its `code` is stable
for programs, its message names the file or field, the value and the limit, and `action` is a
sentence the operator can follow. An estimate that fails is not an error but a value:
`geometry.robust.Failure`.
"""

from __future__ import annotations

from pathlib import Path


class VaoiError(Exception):
    """Something the station refuses or cannot do, with a stable code and a remedy."""

    code = "error"
    status = 500
    """HTTP status a REST caller sees."""

    def __init__(self, message: str, *, action: str = "", code: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.action = action
        if code is not None:
            self.code = code

    def __str__(self) -> str:
        return f"{self.message} {self.action}".strip()

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.message, self.action, self.code))


def _rebuild(cls: type[VaoiError], message: str, action: str, code: str) -> VaoiError:
    """Errors cross process borders; exceptions with keyword arguments do not pickle by themselves."""
    return cls(message, action=action, code=code)


class InputError(VaoiError):
    """A file, field or parameter that somebody gave is wrong; nothing was changed."""

    code = "invalid-input"
    status = 422

    @classmethod
    def field(cls, where: str | Path, key: str, value: object, limit: str, action: str = "") -> InputError:
        """The usual sentence: file or request, key, value, limit."""
        return cls(f"{where}: {key} is {_shown(value)}, but must be {limit}.", action=action)


class NotFoundError(VaoiError):
    """What was asked for does not exist."""

    code = "not-found"
    status = 404


class GoneError(VaoiError):
    """What was asked for existed, and its memory has been given to a later board."""

    code = "gone"
    status = 410


class StateError(VaoiError):
    """The request is sound, but the present state of the station forbids it."""

    code = "wrong-state"
    status = 409


class BusyError(VaoiError):
    """A resource is exhausted for the moment: the ring is full, no worker is left."""

    code = "busy"
    status = 503


class DeviceError(VaoiError):
    """A camera, the controller or the machine does not do what it should."""

    code = "device"
    status = 503


class InternalError(VaoiError):
    """Our own mistake."""

    code = "internal"
    status = 500


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "…"
