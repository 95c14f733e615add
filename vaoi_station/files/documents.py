"""Parse JSON and TOML documents strictly, and write files atomically."""

from __future__ import annotations

import codecs
import json
import math
import os
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from vaoi_station.errors import DeviceError, InputError, InternalError, NotFoundError
from vaoi_station.files.directories import make_directories, sync_directory

M = TypeVar("M", bound=BaseModel)
UNKNOWN_KEY = "is an unknown key"
"""Begin of the text of a fault for a key that the document does not have."""
Place = tuple[int | str, ...]
"""Keys and indices that lead to a value of a document; empty for the document itself."""


class DuplicateKeyError(ValueError):
    """A key appears twice in one JSON object; readers disagree which of the two values is valid."""


def read_json(path: Path) -> Any:
    """Parse a JSON file; refuse duplicate keys, NaN and infinities, which JSON does not have."""
    try:
        data = json.loads(read_text(path), object_pairs_hook=refuse_duplicate_keys)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}: not valid JSON at line {error.lineno}, column {error.colno}: {error.msg}."
        ) from error
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply for a document of this station.") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}.") from error
    if (fault := _not_finite(data)) is not None:
        key, value = fault
        raise InputError.field(path, key or "the document", value, "a finite number")
    return data


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file."""
    return parse_toml(read_text(path), path)


def parse_toml(text: str, where: str | Path) -> dict[str, Any]:
    """Parse a TOML text, which messages name `where`."""
    try:
        # A text in a request may still have the mark of the file from which it was copied.
        return tomllib.loads(text.removeprefix("\ufeff"))
    except RecursionError as error:
        raise InputError(f"{where}: is nested too deeply for a document of this station.") from error
    # Besides its own error tomllib raises that of `int`, for numbers of thousands of digits.
    except ValueError as error:
        raise InputError(f"{where}: not valid TOML: {error}.") from error


def parse(model: type[M], data: Any, where: str | Path, action: str = "") -> M:
    """Validate parsed data; raise InputError with file, key, value and limit of the first five faults, and `action`."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(describe(error, where), action=action) from error


def check_format(data: Any, path: Path, name: str, version: int) -> None:
    """Refuse a document of another format or of a newer version; called before any other key is checked."""
    if not isinstance(data, dict):
        raise InputError(f"{path}: holds a {type(data).__name__}, must be an object with 'format' and 'version'.")
    if data.get("format") != name:
        raise InputError.field(path, "format", data.get("format"), f"{name!r}")
    found = data.get("version")
    if found != version or isinstance(found, bool):
        newer = isinstance(found, int) and found > version
        action = "Use a newer vaoi_station to read it." if newer else ""
        raise InputError.field(path, "version", found, f"{version}", action)


def describe(error: ValidationError, where: str | Path) -> str:
    """Describe the faults of a document, at most five of them."""
    lines = [f"{where}: {key_at(place)}: {text}" for place, text in faults_of(error)]
    return "; ".join(lines[:5]) + ("." if len(lines) <= 5 else f"; and {len(lines) - 5} more.")


def faults_of(error: ValidationError) -> Iterator[tuple[Place, str]]:
    """Yield every fault of a document: its place, and a text with the fault, the limit and the given value."""
    for fault in _causes(error.errors(include_url=False)):
        message = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "extra_forbidden":
            message = UNKNOWN_KEY
        given = fault.get("input")
        # The address of a receiver may hold the token by which it knows the sender; messages reach logs and bundles.
        hidden = isinstance(given, dict | list | tuple) or fault["type"] == "missing" or fault["loc"][-1:] == ("url",)
        shown = "" if hidden else f" (given: {given!r:.80})"
        yield fault["loc"], f"{message}{shown}"


def key_at(place: Place) -> str:
    """Return a place as the key that a reader finds in the document, such as `cameras.1.width`."""
    return ".".join(map(str, place)) or "the document"


def write_json(path: Path, data: Any, *, mode: int = 0o644) -> None:
    """Write a JSON document atomically; raise InternalError if a number is not finite."""
    if (fault := _not_finite(data)) is not None:
        raise InternalError(f"{path}: {fault[0]} is {fault[1]}, which JSON cannot hold; nothing was written.")
    write_bytes(path, (json.dumps(data, indent=1, allow_nan=False) + "\n").encode(), mode=mode)


def write_bytes(path: Path, content: bytes, *, durable: bool = True, mode: int = 0o644) -> None:
    """Write a file so that readers see the old or the new content, never a part.

    Args:
        path: the file. Its directory is created if it is absent.
        content: all bytes of the file.
        durable: return only when the file, under its name, survives a power failure.
        mode: permissions of the file.

    Raises:
        InputError: the path is not a file, or cannot be written to.
        DeviceError: the disk is full or damaged; the old content stays.
    """
    path = path.resolve()  # a symbolic link stays; its target is written
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a file and is not overwritten.", action="Give the path of a file.")
    try:
        make_directories(path.parent)
        # The temporary file is in the same directory, because a rename is atomic only within one file system.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).", action="Choose another place.") from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fchmod(file.fileno(), mode)
            # Without fsync, a power failure after the rename can leave an empty file under the new name.
            if durable:
                os.fsync(file.fileno())
        Path(name).replace(path)
        # A rename is on the disk only when its directory is: without this, a revoked key would be valid again.
        if durable:
            sync_directory(path.parent)
    except BaseException as error:  # also after Ctrl-C: remove the temporary file, then raise again
        with suppress(OSError):  # a damaged disk may refuse this too; the first error is the one to report
            Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise DeviceError(
                f"{path}: cannot be written ({error.strerror}).",
                action="Check the space and the state of the disk.",
                code="file-not-written",
            ) from error
        raise


def _causes(faults: Sequence[ErrorDetails]) -> Iterator[ErrorDetails]:
    """Yield the faults, except that an array is too short only because its items were refused."""
    for fault in faults:
        inside = (other["loc"][: len(fault["loc"])] == fault["loc"] for other in faults if other is not fault)
        if fault["type"] != "too_short" or not any(inside):
            yield fault


def _not_finite(data: Any, key: str = "") -> tuple[str, float] | None:
    """Return key and value of the first NaN or infinity; Python's JSON reader accepts them."""
    if isinstance(data, float):
        return None if math.isfinite(data) else (key, data)
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list | tuple) else ()
    faults = (_not_finite(value, f"{key}.{name}" if key else str(name)) for name, value in items)
    return next((fault for fault in faults if fault is not None), None)


def refuse_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build an object from pairs (key, value) for the JSON reader; raise DuplicateKeyError if a key appears twice."""
    keys = dict(pairs)
    if len(keys) != len(pairs):
        twin = next(k for n, (k, _) in enumerate(pairs) if k in [p[0] for p in pairs[:n]])
        raise DuplicateKeyError(f"key {twin!r} appears twice in one object")
    return keys


_MARKS = (
    (codecs.BOM_UTF8, "UTF-8"),
    (codecs.BOM_UTF16_LE, "UTF-16-LE"),
    (codecs.BOM_UTF16_BE, "UTF-16-BE"),
)
_SAVE = "Save it as UTF-8; a byte order mark is permitted."


def read_text(path: Path, errors: Literal["strict", "replace"] = "strict") -> str:
    """Return the text of a file; raise NotFoundError or InputError with the reason if it cannot be read."""
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise NotFoundError(f"{path}: there is no such file.") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    return text_of(content, path, errors)


def text_of(content: bytes, where: str | Path, errors: Literal["strict", "replace"] = "strict") -> str:
    """Return bytes as text without byte order mark.

    Args:
        content: the bytes of a text.
        where: their name in messages.
        errors: "replace" puts U+FFFD in place of bytes that are not valid.

    Raises:
        InputError: they are not valid in their encoding, or hold a zero character, as UTF-16 without a mark does.
    """
    mark, encoding = next((found for found in _MARKS if content.startswith(found[0])), (b"", "UTF-8"))
    try:
        text = content[len(mark) :].decode(encoding, errors)
    except UnicodeDecodeError as error:
        at = len(mark) + error.start
        raise InputError(f"{where}: is not {encoding} text at byte {at}.", action=_SAVE) from error
    # No JSON or TOML has this character. Read as UTF-8, text in UTF-16 would pass every search for secrets.
    if "\0" in text:
        raise InputError(f"{where}: has a zero character, so it is not {encoding} text.", action=_SAVE)
    return text
