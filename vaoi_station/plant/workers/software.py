"""The software of a process, so that one data set is made by one software."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from pathlib import Path

from vaoi_station.version import __version__


@cache
def software() -> str:
    """Return version and digest of the package's sources, and the versions on which the last digits depend."""
    import cv2
    import numba
    import numpy as np

    # The version alone does not say which commit a worker runs.
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]  # that of the package
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    python = ".".join(platform.python_version_tuple()[:2])
    return (
        f"vaoi_station {__version__} (sources {digest.hexdigest()[:12]}, Python {python}, numpy {np.__version__}, "
        f"numba {numba.__version__}, opencv {cv2.__version__})"
    )
