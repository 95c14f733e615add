"""The refusals of every operation, with their status codes: derived from its method, its path and its answers."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.problems import KINDS, MEDIA_TYPE

NAMES = {
    400: "Malformed",
    401: "KeyRequired",
    403: "NotPermitted",
    404: "NotFound",
    406: "NotAcceptable",
    408: "TooSlow",
    409: "WrongState",
    410: "Gone",
    412: "Changed",
    413: "TooLarge",
    416: "RangeOutside",
    421: "UnknownHost",
    422: "InvalidInput",
    500: "Internal",
    503: "Busy",
}
"""Names of the refusals in the document, by status. Generated clients may use them as names of types."""
_ALWAYS = frozenset({400, 421, 422, 500})
_OF_THE_API = _ALWAYS | {401, 403, 503}
_OF_A_COMMAND = frozenset({408, 409, 413})
_OF_A_RUN = frozenset({404, 409, 410})
_ABSENT = ("/station/arm", "/runs", "/runs/latest", "/runs/next", "/doctor", "/calibration/trial", "/trial/calibration")
"""Ends of paths without parameters that may name something that does not exist, or ask for it."""
_BODY_NAMES_A_RUN = ("/calibration/marks",)
"""Ends of paths whose body names a run from whose frames the answer is made."""


def statuses(method: str, path: str, operation: dict[str, Any]) -> list[int]:
    """Return the status codes with which an operation may be refused, sorted.

    Args:
        method: in lower case.
        path: as in the document, with the names of its parameters in braces.
        operation: its description; its answers and parameters decide about 406, 410, 412 and 416.
    """
    found = set(_OF_THE_API if path.startswith("/api/") else _ALWAYS)
    if method != "get":
        found |= _OF_A_COMMAND
    if "{" in path or path.endswith(_ABSENT):
        found.add(404)
    of_a_run = ("/runs/{run}", "/cameras/{camera}/picture", "reference")
    if any(part in path for part in of_a_run) or path.endswith(("/next", *_BODY_NAMES_A_RUN)):
        found |= _OF_A_RUN
    kinds = [kind for answer in operation["responses"].values() for kind in answer.get("content", {})]
    if "application/x-npy" in kinds:
        found.add(406)
    if "206" in operation["responses"] and "application/x-npy" in kinds:
        found.add(416)
    if any(parameter["name"] == "If-Match" for parameter in operation.get("parameters", ())):
        found.add(412)
    return sorted(found)


def answers() -> dict[str, Any]:
    """Return the descriptions of all refusals, by name, for `components.responses`."""
    return {name: _answer(status) for status, name in sorted(NAMES.items())}


def reference(status: int) -> dict[str, Any]:
    """Return a reference to the description of the refusals with a status."""
    return {"$ref": f"#/components/responses/{NAMES[status]}"}


def _answer(status: int) -> dict[str, Any]:
    kinds = {kind: entry for kind, entry in KINDS.items() if entry[0] == status}
    examples = {
        kind: {
            "summary": title,
            "value": {
                "type": f"/problems/{kind}",
                "title": title,
                "status": status,
                "detail": f"{title}: the field, its value and the limit.",
                "code": kind,
                "action": action,
                "instance": "/api/v1/station",
            },
        }
        for kind, (_, title, action) in kinds.items()
    }
    words = "; ".join(title for _, title, _ in kinds.values())
    content = {"schema": {"$ref": "#/components/schemas/Problem"}, "examples": examples}
    return {"description": f"{words}.", "content": {MEDIA_TYPE: content}}
