"""The headers of answers in the OpenAPI document."""

from __future__ import annotations

from typing import Any

_TEXT, _NUMBER = {"type": "string"}, {"type": "integer", "format": "int32", "minimum": 0}
HEADERS: dict[str, dict[str, Any]] = {
    "X-Vaoi-Version": {"description": "Version of the station's software.", "schema": _TEXT, "example": "0.1.0"},
    "ETag": {
        "description": "Mark of the content: a request with it as If-None-Match gets 304 while nothing has changed.",
        "schema": _TEXT,
        "example": '"5f2b0c1d9a7e4c3b8d6f1a2e3c4b5d6f"',
    },
    "Cache-Control": {"description": "How long the answer stays true.", "schema": _TEXT, "example": "no-store"},
    "Location": {"description": "Address of what is new.", "schema": _TEXT, "example": "/api/v1/board-types/demo"},
    "Retry-After": {"description": "Seconds after which to try again.", "schema": _NUMBER, "example": 1},
    "WWW-Authenticate": {"description": "How to send a key.", "schema": _TEXT, "example": 'Bearer realm="vaoi"'},
    "Set-Cookie": {"description": "The cookie of the login.", "schema": _TEXT, "example": "vaoi-session=…; HttpOnly"},
    "Idempotency-Replayed": {
        "description": "`true`: the command was repeated with its key, and this is the reply of the first time.",
        "schema": _TEXT,
        "example": "true",
    },
    "X-Image-Width": {"description": "Width of the picture, px.", "schema": _NUMBER, "example": 80},
    "X-Image-Height": {"description": "Height of the picture, px.", "schema": _NUMBER, "example": 64},
    "X-Image-Channels": {"description": "1 grey, 3 red, green and blue.", "schema": _NUMBER, "example": 1},
    "X-Image-Dtype": {"description": "Type of a pixel's values, as in numpy.", "schema": _TEXT, "example": "uint8"},
    "X-Image-Stride": {"description": "Bytes per line; only with raw pixels.", "schema": _NUMBER, "example": 80},
    "X-Frame-Verdict": {
        "description": "Whether the frame is complete and proven to belong to its row.",
        "schema": {"type": "string", "enum": ["ok", "incomplete", "unproven"]},
        "example": "ok",
    },
}
"""All headers that answers have, by name."""
_LAYOUT = ("X-Image-Width", "X-Image-Height", "X-Image-Channels", "X-Image-Dtype", "X-Image-Stride")
_OF_REFUSALS = {401: ("WWW-Authenticate",), 503: ("Retry-After",)}
_OF_OPERATIONS = {"get_frame": (*_LAYOUT, "X-Frame-Verdict"), "log_in": ("Set-Cookie",), "log_out": ("Set-Cookie",)}
CONDITIONAL = frozenset(
    {
        "get_board_type", "put_board_type", "list_components", "get_component", "get_component_image", "get_frame",
        "list_merged", "get_merged_image", "get_matrices", "get_heights", "get_run", "get_latest_run",
        "wait_for_next_run", "pin_run", "list_mosaics", "get_dzi", "get_dzi_tile", "get_iiif", "get_iiif_tile",
        "check_board_type", "get_board_check_picture", "get_kept_mosaic", "get_overlay", "get_timeline",
    }
)  # fmt: skip
"""Operations whose answers carry an ETag; those that read give 304 to a caller that has the content already."""
_TAGGED = CONDITIONAL | {
    "get_method", "set_method", "forget_method", "get_reference", "teach_reference", "set_board_type_state",
    "confirm_import", "decide_about_run",
}  # fmt: skip
UNCHANGED = {"description": "The caller has the same content already (If-None-Match)."}


def of_refusal(status: int) -> dict[str, Any]:
    """Return the headers of the refusals with a status, for the document."""
    return _references("X-Vaoi-Version", "Cache-Control", *_OF_REFUSALS.get(status, ()))


def of_answer(method: str, operation: dict[str, Any], status: str, answer: dict[str, Any]) -> dict[str, Any]:
    """Return the headers of one answer of an operation, for the document.

    Args:
        method: in lower case.
        operation: the operation's description.
        status: status code of the answer, as text.
        answer: its description.
    """
    name = operation["operationId"]
    names = ["X-Vaoi-Version", "Cache-Control"]
    if status != "204" and name in _TAGGED:
        names.append("ETag")
    if status == "200" and "application/x-npy" in answer.get("content", {}) and name != "get_frame":
        names += _LAYOUT[-1:] if name != "get_component_image" else _LAYOUT
    if status == "201" and "keys" not in name and "key" not in name:
        names.append("Location")
    if method != "get":
        names.append("Idempotency-Replayed")
    return _references(*names, *_OF_OPERATIONS.get(name, ()))


def _references(*names: str) -> dict[str, Any]:
    return {name: {"$ref": f"#/components/headers/{name}"} for name in names}
