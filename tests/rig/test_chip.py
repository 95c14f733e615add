"""The firmware on its emulated chip: build, run, pins, pulses."""

from __future__ import annotations

import os
import queue
import shutil
import signal
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
from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.rig import chip as firmware
from vaoi_station.rig.chip import (
    HZ,
    TRIGGER,
    Chip,
    Edge,
    Pulse,
    PulseDecoder,
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


@pytest.fixture
def no_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(firmware, "PACKAGED", tmp_path / "package")
    monkeypatch.setattr(firmware, "CHECKOUT", tmp_path / "checkout")


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


def test_missing_sources_are_named(no_sources: None) -> None:
    with pytest.raises(NotFoundError, match=r"its sources are neither in .*package nor in .*checkout") as caught:
        firmware.check_sources()
    assert "from its wheel" in caught.value.action


def test_missing_tools_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match="cannot be built here") as caught:
        firmware.build(tmp_path)
    assert "make gcc gcc-avr avr-libc libsimavr-dev libelf-dev" in caught.value.action


def test_a_build_that_fails_reports_the_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_emulator()
    broken = tmp_path / "firmware"
    shutil.copytree(firmware.CHECKOUT, broken, ignore=shutil.ignore_patterns("build"))
    (broken / "logic" / "boot_counter.c").write_text("#error out of order\n")
    monkeypatch.setattr(firmware, "PACKAGED", broken)
    with pytest.raises(DeviceError, match=r"the firmware does not build: (?s:.*)out of order"):
        firmware.build(tmp_path / "built")


TIMEOUT_S = 20.0


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


def scripted(folder: Path, lines: str) -> Path:
    """A folder with a script in place of the emulator."""
    path = folder / "emulator"
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(0o755)
    return folder


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


def test_a_reset_is_reported(bench: Bench) -> None:
    while bench.resets.qsize():
        bench.resets.get()
    bench.chip.send("reset external")
    bench.resets.get(timeout=TIMEOUT_S)


def test_a_command_after_the_end_is_refused(bench: Bench) -> None:
    os.kill(bench.chip.pid or 0, signal.SIGKILL)
    os.waitid(os.P_PID, bench.chip.pid or 0, os.WEXITED | os.WNOWAIT)
    with pytest.raises(DeviceError, match="the emulated chip has ended"):
        bench.chip.send("pin PB0 1")
    assert not bench.chip.alive


def test_edges_are_dated_by_the_last_clock_line(tmp_path: Path) -> None:
    """A reset starts the clock again; edges before it keep their times."""
    lines = "echo clock 0 1000\necho edge 16 PB1 1\necho clock 100 9000\necho reset 100\necho edge 116 PB1 0\nread line"
    edges: queue.Queue[Edge] = queue.Queue()
    resets: queue.Queue[None] = queue.Queue()
    with Chip(scripted(tmp_path, lines), tmp_path / "trigger", edges.put, lambda: resets.put(None)):
        assert edges.get(timeout=TIMEOUT_S) == Edge(16, "PB1", True, 2000)
        assert edges.get(timeout=TIMEOUT_S) == Edge(116, "PB1", False, 10000)
        assert resets.qsize() == 1


def play(*edges: tuple[float, str, int]) -> list[Pulse]:
    """Edges at µs."""
    decoder = PulseDecoder()
    pulses = [decoder.process(Edge(round(us * 16), pin, bool(level), round(us * 1000))) for us, pin, level in edges]
    return [pulse for pulse in pulses if pulse is not None]


def test_a_shot_is_known_when_its_light_is_out() -> None:
    edges = [(0, "PD5", 1), (2000, "PB1", 1), (2000, "PB2", 1), (2100, "PB1", 0), (2250, "PB2", 0), (2300, "PD5", 0)]
    assert play(*edges) == [Pulse(32000, 2_000_000, (1,), 250.0, 100.0)]
    assert play(*edges[:4]) == []


def test_a_flash_may_end_before_the_trigger() -> None:
    [pulse] = play((0, "PD4", 1), (10, "PB2", 1), (10, "PB1", 1), (60, "PB2", 0), (410, "PB1", 0))
    assert (pulse.channels, pulse.on_us, pulse.width_us) == ((0,), 50.0, 400.0)


def test_light_before_the_trigger_is_not_seen() -> None:
    [pulse] = play((0, "PD4", 1), (10, "PB2", 1), (110, "PB1", 1), (210, "PB1", 0), (260, "PB2", 0))
    assert pulse.on_us == 150.0


def test_light_without_a_trigger_is_no_shot_and_is_not_the_next_ones() -> None:
    before = [(0, "PD4", 1), (10, "PB2", 1), (60, "PB2", 0), (70, "PD4", 0)]
    [pulse] = play(*before, (1000, "PD6", 1), (2000, "PB1", 1), (2000, "PB2", 1), (2100, "PB2", 0), (2100, "PB1", 0))
    assert (pulse.channels, pulse.on_us) == ((2,), 100.0)
