"""Cameras of foreign networks: found by broadcast, given an address, kept for the next power-on."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from tests.acquisition.cameras.aravis.wire.stage import Device
from tests.gige.foreign import ForeignCamera
from vaoi_station.acquisition.cameras.aravis.discovery import FoundCamera, discover, find, free_address, set_address
from vaoi_station.acquisition.cameras.aravis.network import Control
from vaoi_station.errors import DeviceError, InputError, StateError

FREE = "127.0.0.77"


@pytest.fixture
def foreign() -> Iterator[ForeignCamera]:
    camera = ForeignCamera("F0REIGN1")
    yield camera
    camera.close()


def found(serial: str) -> FoundCamera:
    return find(serial, discover(0.4))


def test_a_camera_of_a_foreign_network_is_listed_beside_those_of_ours(
    foreign: ForeignCamera, device: Callable[..., Device]
) -> None:
    near, far = found(device(0).serial), found(foreign.serial)
    assert (near.in_network, near.control) == (True, Control.FREE)
    assert near.model
    assert (far.address, far.maker, far.model, far.interface) == ("10.9.8.7", "Test", "Foreign", "lo")
    assert (far.in_network, far.control) == (False, Control.ABSENT)


def test_an_address_is_taken_at_once_and_kept(foreign: ForeignCamera) -> None:
    set_address(found(foreign.serial), FREE)
    assert foreign.address == FREE
    kept = [socket.inet_ntoa(foreign.read(at, 4)) for at in (0x64C, 0x65C)]
    assert kept == [FREE, "255.0.0.0"]
    assert foreign.number(0x14) == 0b111, "the persistent address is used, and DHCP and link-local stay as they were"
    assert foreign.number(0xA00) == 0, "and no program controls it"
    now = found(foreign.serial)
    assert (now.address, now.in_network, now.control) == (FREE, True, Control.FREE)


def test_an_address_is_kept_although_a_station_opens_the_camera_there_at_first(foreign: ForeignCamera) -> None:
    far, foreign.refuses = found(foreign.serial), {0xA00}
    leaves = threading.Timer(1.0, foreign.refuses.clear)
    leaves.start()
    set_address(far, FREE)
    leaves.join()
    assert socket.inet_ntoa(foreign.read(0x64C, 4)) == FREE


def test_an_address_that_cannot_be_is_refused_with_its_cause(
    foreign: ForeignCamera, device: Callable[..., Device]
) -> None:
    far, near = found(foreign.serial), device(1)
    with pytest.raises(InputError, match=r"address.*192\.168\.3\.4.*127\.0\.0\.0/8"):
        set_address(far, "192.168.3.4")
    with pytest.raises(StateError, match=rf"Another device has the address {near.address}"):
        set_address(far, near.address)
    foreign.refuses = {0x64C}
    with pytest.raises(DeviceError, match="does not keep it"):
        set_address(far, FREE)


def test_a_camera_that_another_program_controls_keeps_its_address(foreign: ForeignCamera) -> None:
    foreign.take()
    with pytest.raises(DeviceError, match=r"Another program controls the camera F0REIGN1 at 10\.9\.8\.7") as refused:
        set_address(found(foreign.serial), FREE)
    assert (refused.value.code, foreign.address) == ("camera-in-use", "10.9.8.7")
    foreign.release()
    set_address(found(foreign.serial), FREE)
    foreign.take("10.1.2.3")
    with pytest.raises(DeviceError, match=r"Another program on 10\.1\.2\.3 controls the camera F0REIGN1"):
        set_address(found(foreign.serial), "127.0.0.78")
    assert foreign.address == FREE


def test_the_address_of_the_predecessor_is_preferred_if_it_is_free(foreign: ForeignCamera) -> None:
    far = found(foreign.serial)
    assert free_address(far, ["10.1.1.1", FREE], ()) == FREE
    assert free_address(far, [FREE], (FREE,)) not in (FREE, "127.0.0.1", "127.0.0.2")


def test_behind_the_last_address_of_a_network_the_search_goes_on_with_its_first_one() -> None:
    camera = FoundCamera("S", "10.0.0.1", interface="lo", local="127.255.255.254/8")
    assert free_address(camera, (), ("127.0.0.2",)).startswith("127.0.0.")


def test_no_camera_and_two_of_one_number_are_refused() -> None:
    one = FoundCamera("S", "10.0.0.1", "02:00:00:00:00:01")
    with pytest.raises(DeviceError, match="No camera with serial number 'T'"):
        find("T", [one])
    with pytest.raises(DeviceError, match="2 cameras have the serial number 'S'"):
        find("S", [one, FoundCamera("S", "10.0.0.2")])
