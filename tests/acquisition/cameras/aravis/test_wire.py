"""Tests that need a separate network: the files in `wire/`, each in a process with a network namespace.

Real GVCP and GVSP between cameras of the virtual rig and our backend; GigE Vision has one fixed port, so no other
cameras may be on that network.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.needs import need_aravis
from tests.processes import run_in_own_network

WIRE = Path(__file__).parent / "wire"


@pytest.mark.aravis
@pytest.mark.parametrize("name", sorted(path.name for path in WIRE.glob("wire_*.py")))
def test_in_a_network_of_its_own(name: str) -> None:
    need_aravis()
    done = run_in_own_network(
        *(sys.executable, "-m", "pytest", "--quiet", "--no-header", "-p", "no:cacheprovider"),
        *("-o", "python_files=wire_*.py", str(WIRE / name)),
    )
    if done.returncode:
        pytest.fail(f"{' '.join(done.args)}\n{done.stdout}\n{done.stderr}", pytrace=False)
