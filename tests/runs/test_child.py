"""How a process of the station begins."""

from __future__ import annotations

import subprocess
import sys

FAULTS = """
import resource, sys
import numpy as np
from vaoi_station.runs.child import keep_memory

if sys.argv[1] == "kept":
    keep_memory()
for _ in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(1 << 20) for _ in range(4)]
    del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    done = subprocess.run([sys.executable, "-c", FAULTS, how], stdout=subprocess.PIPE, text=True, check=True)
    return int(done.stdout)


def test_memory_that_was_given_back_is_not_had_anew() -> None:
    assert faults("kept") < 100 < faults("as it is")
