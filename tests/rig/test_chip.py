"""The firmware on its emulated chip: build, run, pins, pulses."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.needs import need_emulator
from tests.rig.host import Host
from vaoi_station.acquisition.controller.protocol import Step
from vaoi_station.errors import DeviceError
from vaoi_station.rig import chip as firmware
from vaoi_station.rig.chip import (
    HZ,
    TRIGGER,
    Chip,
    Edge,
)
from vaoi_station.simulation import Scenario

ROOT = Path(__file__).resolve().parents[2]
BUILD_WHEEL = "import sys; from hatchling.build import build_wheel; build_wheel(sys.argv[1])"
BUILD_FIRMWARE = """
import sys
from pathlib import Path
from vaoi_station.rig import chip as firmware
assert firmware.find_sources() == firmware.PACKAGED, firmware.find_sources()
firmware.check_sources()
print(firmware.build(Path(sys.argv[1])))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked wheel of this checkout, which is what pip puts into site-packages."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([sys.executable, "-c", BUILD_WHEEL, str(folder)], cwd=ROOT, check=True, capture_output=True)
    [wheel] = folder.glob("*.whl")
    site = folder / "site-packages"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    return site


def run_installed(site: Path, folder: Path, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program outside the checkout, with the installed package in front of the checkout's."""
    environment = os.environ | {"PYTHONPATH": str(site), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_installed_package_builds_firmware_and_emulator(installed: Path, tmp_path: Path) -> None:
    need_emulator()
    before = sorted(path.relative_to(installed) for path in installed.rglob("*"))
    built = tmp_path / "built"
    done = run_installed(installed, tmp_path, BUILD_FIRMWARE, str(built))
    assert (done.returncode, done.stdout.strip()) == (0, str(built)), done.stderr
    assert (built / "firmware.elf").is_file()
    assert os.access(built / "emulator", os.X_OK)
    after = sorted(path.relative_to(installed) for path in installed.rglob("*"))
    assert after == before, "the build must write only into the given folder"


def test_the_wheel_has_the_sources_of_the_checkout_and_no_build_products(installed: Path) -> None:
    packaged = installed / "vaoi_station" / "rig" / "hardware"
    files = [path for path in packaged.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} <= {".c", ".h", ".md", ""}
    for path in files:
        assert path.read_bytes() == (ROOT / "hw" / path.relative_to(packaged)).read_bytes()
    for folder in ("firmware/chip", "firmware/logic", "virtual_rig"):
        sources = {path.relative_to(ROOT / "hw") for path in (ROOT / "hw" / folder).rglob("*.[ch]")}
        assert sources <= {path.relative_to(packaged) for path in files}


def test_missing_tools_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match="cannot be built here") as caught:
        firmware.build(tmp_path)
    assert "make gcc gcc-avr avr-libc libsimavr-dev libelf-dev" in caught.value.action


@dataclass
class Bench:
    """A running chip and what it reports."""

    chip: Chip
    edges: queue.Queue[Edge]
    resets: queue.Queue[None]


@pytest.fixture
def bench(built: Path, tmp_path: Path) -> Iterator[Bench]:
    edges: queue.Queue[Edge] = queue.Queue()
    resets: queue.Queue[None] = queue.Queue()
    with Chip(built, tmp_path / "trigger", edges.put, lambda: resets.put(None)) as chip:
        yield Bench(chip, edges, resets)


def test_a_board_in_the_barrier_fires_triggers_with_their_cycles(bench: Bench, small: Scenario) -> None:
    with Host(bench.chip.terminal) as host:
        host.arm(small, (Step(0b0001, 500),))
        blocked = bench.chip.cycle_at(time.monotonic_ns()) + HZ // 20
        bench.chip.send(f"at {blocked} PB0 1")
        host.wait(small.line.start_delay_s + 0.3)
    edges = [bench.edges.get_nowait() for _ in range(bench.edges.qsize())]
    first = next(edge for edge in edges if edge.pin == TRIGGER and edge.level)
    assert (first.cycle - blocked) / HZ == pytest.approx(small.line.start_delay_s, abs=1e-5)
    assert first.host_ns == bench.chip.host_ns(first.cycle)
    assert [edge.cycle for edge in edges] == sorted(edge.cycle for edge in edges)
