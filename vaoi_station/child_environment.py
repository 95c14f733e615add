"""The environment of child processes that run modules of this package."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def child_environment(**more: str) -> dict[str, str]:
    """Return the environment in which a new Python process imports the same modules as this one, and further variables.

    With `-P`, which keeps modules in the current folder from being imported, a child would not find the package of a
    source checkout that was started by `python -m`, or would find another version that is installed.
    """
    package = str(Path(__file__).parent.parent)
    # First, as this process has found it: an editable installation names its folder last, behind other versions.
    # An empty entry is the current folder.
    entries = [package, *(entry for entry in sys.path if entry not in ("", package))]
    return os.environ | {"PYTHONPATH": os.pathsep.join(entries)} | more
