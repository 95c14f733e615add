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
    entries = [entry for entry in sys.path if entry]  # An empty one is the current folder.
    package = str(Path(__file__).parent.parent)
    if package not in entries:
        entries.insert(0, package)
    return os.environ | {"PYTHONPATH": os.pathsep.join(entries)} | more
