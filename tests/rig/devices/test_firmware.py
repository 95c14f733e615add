"""The firmware's sources are found and build from a checkout and from an installed wheel."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.needs import need_emulator
from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.rig import chip as firmware

ROOT = Path(__file__).resolve().parents[3]
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


def test_a_checkout_uses_its_own_sources() -> None:
    assert firmware.find_sources() == ROOT / "hw" / "firmware"


def test_the_packaged_sources_come_before_a_folder_hw_beside_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_sources: None
) -> None:
    for folder in (firmware.PACKAGED, firmware.CHECKOUT):
        folder.mkdir()
        (folder / "Makefile").touch()
    assert firmware.find_sources() == firmware.PACKAGED
    (firmware.PACKAGED / "Makefile").unlink()
    assert firmware.find_sources() == firmware.CHECKOUT


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
