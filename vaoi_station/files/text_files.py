"""Read text that other programs write: UTF-8, with or without a byte order mark, or UTF-16 with one.

Editors and shells of Windows begin a file with a mark: Notepad one of UTF-8, `>` of Windows PowerShell 5 one of UTF-16.
The mark is no part of the text.
"""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import Literal

from vaoi_station.errors import InputError, NotFoundError

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
