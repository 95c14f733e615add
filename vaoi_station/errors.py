"""Errors with a responsible party, a stable code and an action.

Every error that leaves a package of the station is a `VaoiError`. Its class names who can remove the cause: the caller
(input), a device, the present state of the station, or the developers. `code` is stable for programs. The message
names the file or field, the value and the limit. `action` is a sentence that the operator can follow. An estimate that
fails is not an error but a value: `geometry.robust.Failure`.
"""

from __future__ import annotations

from pathlib import Path


class VaoiError(Exception):
    """A request that the station refuses or cannot carry out."""

    code = "error"
    status = 500
    """HTTP status with which the REST service replies to a request that raises this error."""

    def __init__(self, message: str, *, action: str = "", code: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.action = action
        if code is not None:
            self.code = code

    def __str__(self) -> str:
        return f"{self.message} {self.action}".strip()

    def __reduce__(self) -> tuple[object, ...]:
        # Workers and the acquisition process send errors through pipes. Exception.__reduce__ keeps positional
        # arguments only, so `action` and `code` would be lost without this method.
        return (_rebuild, (type(self), self.message, self.action, self.code))


def _rebuild(cls: type[VaoiError], message: str, action: str, code: str) -> VaoiError:
    return cls(message, action=action, code=code)


class InputError(VaoiError):
    """A file, field or parameter is wrong; nothing was changed."""

    code = "invalid-input"
    status = 422

    @classmethod
    def field(cls, where: str | Path, key: str, value: object, limit: str, action: str = "") -> InputError:
        """Return an error with the standard message: file or request, key, value and limit."""
        return cls(f"{where}: {key} is {_shown(value)}, but must be {limit}.", action=action)


class NotFoundError(VaoiError):
    """The object that was requested does not exist."""

    code = "not-found"
    status = 404


class GoneError(VaoiError):
    """What was requested existed and is no longer kept: frames, a recording, or a result."""

    code = "gone"
    status = 410


class StateError(VaoiError):
    """The request is valid, but the present state of the station forbids it."""

    code = "wrong-state"
    status = 409


class BusyError(VaoiError):
    """A resource is used up at present: the ring is full, or too many callers wait."""

    code = "busy"
    status = 503


class DeviceError(VaoiError):
    """A camera, the controller or the computer does not work as required."""

    code = "device"
    status = 503


class InternalError(VaoiError):
    """A software fault of the station."""

    code = "internal"
    status = 500


def _shown(value: object) -> str:
    # A request may contain megabytes in one field, and the message is written to logs and shown on the operator's page.
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "…"
