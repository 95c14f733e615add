"""The path under which a reverse proxy offers the station, such as `/aoi`."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, Field

LONGEST = 200
IN_WORDS = "a path such as /aoi: names of letters, digits and ._~- that begin with no dot, each behind one slash"
OWN_PATHS = frozenset({"api", "docs", "favicon.ico", "healthz", "metrics", "problems", "readyz", "web"})
"""First names of the station's own addresses."""
# No name begins with a dot, so that none leads upwards, and none is empty, so that the path names no other host.
_FORM = re.compile(r"(/[A-Za-z0-9_~-][A-Za-z0-9._~-]*)+")


def is_root_path(path: str) -> bool:
    """Return whether a text is a path of one or more names."""
    return len(path) <= LONGEST and _FORM.fullmatch(path) is not None


def _checked(path: str) -> str:
    if path and not is_root_path(path):
        raise ValueError(f"must be {IN_WORDS}, none at the end")
    if (first := path.partition("/")[2].partition("/")[0]) in OWN_PATHS:
        raise ValueError(f"must not begin with /{first}, which is an address of the station's own")
    return path


RootPath = Annotated[str, Field(max_length=LONGEST), AfterValidator(_checked)]
"""A path that the proxy passes on unchanged; empty if there is none."""
