"""The software of a process is stated by version, sources and libraries."""

from __future__ import annotations

import re

from vaoi_station.plant.workers.software import software


def test_version_sources_and_libraries_are_stated() -> None:
    assert re.fullmatch(
        r"vaoi_station \S+ \(sources [0-9a-f]{12}, Python 3\.\d+, numpy \S+, numba \S+, opencv \S+\)", software()
    )
