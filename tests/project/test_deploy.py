"""The deployment files suffice for the example array."""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from vaoi_station.acquisition.cameras.aravis.opening import socket_bytes
from vaoi_station.config import read_config
from vaoi_station.doctor.checks.network import judge_buffers
from vaoi_station.doctor.checks.usb import PARAMETER, judge_memory
from vaoi_station.doctor.finding import Level

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
PAPER = read_config(DEPLOY / "station-paper.toml")


def lines(name: str) -> list[str]:
    text = (DEPLOY / name).read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_socket_buffers_hold_one_second_of_the_papers_cameras() -> None:
    (line,) = lines("60-vaoi.conf")
    key, value = line.split(" = ")
    needed = max(socket_bytes(camera, PAPER.line.trigger_period_s) for camera in PAPER.cameras)
    assert key == "net.core.rmem_max"
    assert judge_buffers(int(value), needed).level is Level.OK


def test_usb_memory_suffices_for_the_array() -> None:
    (line,) = lines("vaoi-usb-memory.conf")
    kind, path, *_, value = line.split()
    assert (kind, path) == ("w", f"/{PARAMETER}")
    assert judge_memory(int(value), len(PAPER.cameras)).level is Level.OK


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
