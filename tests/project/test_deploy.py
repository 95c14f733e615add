"""The deployment files suffice for the example array."""

from __future__ import annotations

import re
import subprocess
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tests.needs import lacking, need
from vaoi_station.acquisition.cameras.aravis.camera import receive_limit_bytes
from vaoi_station.config import read_config
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine_checks import USB_PARAMETER, judge_buffers, judge_usb_memory

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
PAPER = read_config(DEPLOY / "station-paper.toml")


def lines(name: str) -> list[str]:
    text = (DEPLOY / name).read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_socket_buffers_hold_two_frames_of_each_of_the_papers_cameras() -> None:
    (line,) = lines("60-vaoi.conf")
    key, value = line.split(" = ")
    needed = receive_limit_bytes(PAPER.cameras, PAPER.line.trigger_period_s)
    assert needed == 2 * len(PAPER.cameras) * 1392 * 1040
    assert key == "net.core.rmem_max"
    assert judge_buffers(int(value), needed).level is Level.OK


def test_usb_memory_suffices_for_the_array() -> None:
    (line,) = lines("vaoi-usb-memory.conf")
    kind, path, *_, value = line.split()
    assert (kind, path) == ("w", f"/{USB_PARAMETER}")
    assert judge_usb_memory(int(value), len(PAPER.cameras)).level is Level.OK


@pytest.mark.parametrize(
    ("interfaces", "given"),
    [(":ef0500:ef0501:ef0502:", True), (":ef0500:", True), (":030101:030102:", False), (":ef0201:", False)],
)
def test_udev_rule_matches_usb3_vision_interfaces(interfaces: str, given: bool) -> None:
    """Class EF, subclass 05, protocol 00 controls a device of USB3 Vision; udev matches as a shell does."""
    (line,) = lines("70-vaoi-cameras.rules")
    pairs = re.findall(r'(?:^|, )([A-Z]+(?:\{\w+\})?)(==|\+?=)"([^"]*)"', line)
    assert ", ".join(f'{key}{operator}"{value}"' for key, operator, value in pairs) == line
    rule = {key: value for key, _, value in pairs}
    assert fnmatchcase(interfaces, rule["ENV{ID_USB_INTERFACES}"]) is given
    assert rule["GROUP"] in service("SupplementaryGroups")


def service(key: str) -> list[str]:
    (value,) = [line.partition("=")[2] for line in lines("vaoi-station.service") if line.startswith(f"{key}=")]
    return value.split()


def test_service_may_lock_its_ring_and_use_its_port() -> None:
    assert service("LimitMEMLOCK") == ["infinity"]
    port = (DEPLOY / "71-vaoi-controller.rules").read_text(encoding="utf-8")
    (group,) = set(re.findall(r'GROUP="(\w+)"', port))
    assert group in service("SupplementaryGroups")
    assert PAPER.controller.port == "/dev/" + re.findall(r'SYMLINK\+="([\w-]+)"', port)[0]


@pytest.mark.parametrize("name", ["vaoi-station.service", "vaoi-hermes-tap.service"])
def test_service_has_few_privileges(name: str) -> None:
    """The exposure level of `systemd-analyze security`, 0 to 10, is at most 2.0, and systemd knows every key."""
    need("systemd-analyze")
    unit = DEPLOY / name
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=20", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "unrecognized option" in done.stderr:
        lacking("systemd-analyze examines a file from version 250 on: update the package systemd")
    assert done.returncode == 0, done.stdout[-300:]
    assert "Unknown key" not in done.stderr


def test_service_has_what_aravis_and_numba_need() -> None:
    assert {"AF_UNIX", "AF_INET", "AF_INET6", "AF_NETLINK"} == set(service("RestrictAddressFamilies"))
    # Numba compiles into memory, and machine code from its cache is loaded there as well.
    assert not [line for line in lines("vaoi-station.service") if line.startswith("MemoryDenyWriteExecute")]
    devices = [line for line in lines("vaoi-station.service") if line.startswith("DeviceAllow=char-")]
    assert {line.split("char-")[1].split()[0] for line in devices} == {"ttyUSB", "ttyACM", "usb_device"}


def test_alerts_use_metrics_that_exist() -> None:
    rules = (DEPLOY / "monitoring" / "alerts.yml").read_text(encoding="utf-8")
    page = (DEPLOY.parent / "docs" / "reference" / "metrics.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"`(vaoi_[a-z_]+)", page))
    named = {name.removesuffix("_bucket") for name in re.findall(r"\bvaoi_[a-z_]+", rules)}
    assert named
    assert sorted(named - documented) == []
