"""Tests that need a separate network: the files in `wire/`, each in a process with a network namespace.

Real GVCP and GVSP between Aravis' fake cameras and our backend; GigE Vision has one fixed port, so no other
cameras may be on that network.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.needs import need_aravis
from vaoi_station.rig.devices.network import NAMESPACE_VARIABLE, isolation_command

WIRE = Path(__file__).parent / "wire"
ROOT = Path(__file__).parents[4]


@pytest.mark.aravis
@pytest.mark.parametrize("name", sorted(path.name for path in WIRE.glob("wire_*.py")))
def test_in_a_network_of_its_own(name: str) -> None:
    need_aravis()
    command = [
        *isolation_command(),
        *(sys.executable, "-m", "pytest", "--quiet", "--no-header", "-p", "no:cacheprovider"),
        *("-o", "python_files=wire_*.py", str(WIRE / name)),
    ]
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | {NAMESPACE_VARIABLE: "1"},
        check=False,
        timeout=280,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.fail(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}", pytrace=False)
