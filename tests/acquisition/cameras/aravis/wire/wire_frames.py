"""Frames on their way from a camera's sensor to the reader of the ring."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, Device, Stage, noise, thread_names
from vaoi_station.acquisition.cameras.aravis import stream
from vaoi_station.acquisition.cameras.aravis.library import aravis
from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.ring import Ring
from vaoi_station.config import StationConfig
from vaoi_station.pixel_formats import PIXEL_FORMATS, picture

Plug = Callable[..., Device]
Make = Callable[..., StationConfig]
Open = Callable[[StationConfig], Stage]


def test_aravis_writes_where_the_stitcher_reads(
    device: Plug, station: Make, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The address of each buffer is that of its slot; a reader's mapping then shows the frame."""
    camera = device(0)
    camera.show(noise(1), noise(2))
    stage = opened(station(camera))
    library, addresses = aravis(), []

    def new_buffer(size: int, address: int) -> object:
        addresses.append(address)
        return library.Buffer.new(size, address)

    recording = SimpleNamespace(Buffer=SimpleNamespace(new=new_buffer), BufferStatus=library.BufferStatus)
    monkeypatch.setattr(stream, "aravis", lambda: recording)
    stage.load()
    slots = range(stage.ring.layout.slots_per_camera)
    assert addresses == [stage.ring.memory(number).ctypes.data for number in slots]
    with Ring.attach(stage.ring.path) as reader:
        for number in (1, 0):
            camera.fire(number)
            arrival = stage.arrival()
            assert arrival.complete, arrival.fault
            assert (reader.frame(arrival.slot).ravel() == noise(number + 1)).all()


def test_a_camera_exposes_for_the_width_of_the_trigger_while_that_is_set(
    device: Plug, station: Make, opened: Open
) -> None:
    """The feature ExposureMode over GVCP, and the brightness of frames that follow from it over GVSP."""
    camera = device(0)
    camera.show(noise(1))
    stage = opened(station(camera))
    stage.load()
    means = []
    for exposures_us in ((100.0,), (100.0, 25.0), (100.0,)):
        wanted = CameraExposure(exposures_us, 0.0, by_trigger=len(exposures_us) > 1)
        stage.cameras[0].set_exposure(wanted)
        camera.fire(0, by_width=0.25)
        arrival = stage.arrival()
        assert arrival.complete, arrival.fault
        means.append(stage.slot(arrival.slot).memory.mean())
    assert means[0] == means[2] == noise(1).mean()
    assert means[1] == pytest.approx(means[0] / 4, rel=0.05)


def test_every_frame_has_its_own_number_and_pixels_over_the_wrap(device: Plug, station: Make, opened: Open) -> None:
    """The rig's camera counts from 65400; 0 never occurs."""
    camera = device(0)
    pictures = [noise(seed) for seed in range(7)]
    camera.show(*pictures)
    stage = opened(station(camera))
    stage.load()
    ids = []
    last_s = -1.0
    for k in range(150):
        sent = camera.fire(k % 7)
        arrival = stage.arrival()
        assert arrival.complete, arrival.fault
        assert arrival.frame_id == sent
        assert (stage.ring.memory(arrival.slot) == pictures[k % 7]).all()
        assert arrival.time_s is not None
        assert arrival.time_s > last_s
        last_s = arrival.time_s
        ids.append(sent)
        stage.cameras[0].queue(stage.slot(arrival.slot))
    assert 65535 in ids
    assert ids[ids.index(65535) + 1] == 1
    assert stage.cameras[0].health().delivered == 150


def test_a_frame_that_lost_packets_is_incomplete_and_has_a_reason(device: Plug, station: Make, opened: Open) -> None:
    camera = device(0)
    camera.show(noise(1), noise(2))
    stage = opened(station(camera, packet_bytes=600))
    stage.load()
    camera.fire(0)
    first = stage.arrival()
    camera.fire(1, lost=0.4)
    torn = stage.arrival()
    camera.fire(0)
    last = stage.arrival()
    assert [first.complete, torn.complete, last.complete] == [True, False, True]
    assert (torn.frame_id, torn.time_s) == (None, None), "they may be an older frame's"
    assert torn.fault in ("parts of the frame did not arrive in time", "packets of the frame were lost on the way")
    assert last.frame_id == (first.frame_id or 0) + 2
    health = stage.cameras[0].health()
    assert (health.delivered, health.incomplete) == (2, 1)
    assert dict(health.counters)["n_missing_packets"] > 0


def test_formats_cross_the_wire_as_they_are(device: Plug, station: Make, opened: Open) -> None:
    camera = device(0, "formats")
    for name in ("Mono10", "Mono10Packed", "Mono10p", "Mono12Packed", "Mono12p", "Mono16", "BayerRG8", "BayerGB12p"):
        known = PIXEL_FORMATS[name]
        frame = noise(3, known.nbytes(WIDTH, HEIGHT))
        camera.show(frame)
        stage = opened(station(camera, pixel_format=name))
        stage.load()
        camera.fire(0)
        arrival = stage.arrival()
        assert arrival.complete, arrival.fault
        assert (stage.ring.memory(arrival.slot) == frame).all()
        assert (stage.ring.frame(arrival.slot) == picture(frame, WIDTH, HEIGHT, known)).all()
        stage.close()


def test_slots_that_were_taken_back_are_never_written_again(device: Plug, station: Make, opened: Open) -> None:
    camera = device(0)
    camera.show(noise(1))
    stage = opened(station(camera))
    count = stage.ring.layout.slots_per_camera
    stage.load()
    camera.fire(0)
    used = stage.arrival().slot
    assert sorted([used, *stage.cameras[0].take_back()]) == list(range(count))
    assert stage.cameras[0].take_back() == []
    for slot in range(count):
        stage.ring.memory(slot)[:] = 170
    before = stage.counted("n_underruns")
    camera.fire(0)
    stage.wait(lambda: stage.counted("n_underruns") > before)
    stage.load(bay=1)
    camera.fire(0)
    arrival = stage.arrival()
    assert stage.ring.layout.place(arrival.slot)[0] == 1, "the frame between found no memory"
    for slot in range(count):
        assert (stage.ring.memory(slot) == 170).all()


def test_no_slot_is_given_twice_while_frames_arrive(device: Plug, station: Make, opened: Open) -> None:
    """Slots are queued and taken back in the middle of frames; each comes back once, and is then left alone."""
    camera = device(0)
    camera.show(noise(1, 640 * 480))
    stage = opened(station(camera, width=640, height=480, packet_bytes=600))
    slots = range(stage.ring.layout.slots_per_camera)
    ending, sent = threading.Event(), threading.Semaphore(0)

    def pour() -> None:
        while not ending.is_set():
            camera.fire(0)
            sent.release()

    pouring = threading.Thread(target=pour)
    pouring.start()
    whole = 0
    try:
        for _ in range(100):
            stage.load()
            arrivals = [stage.arrival()]
            back = stage.cameras[0].take_back()
            while not stage.news.empty():
                arrivals.append(stage.arrival())
            assert sorted([*back, *(arrival.slot for arrival in arrivals)]) == list(slots)
            at_rest = [stage.ring.memory(k).copy() for k in slots]
            while sent.acquire(blocking=False):
                pass
            sent.acquire(timeout=20)
            sent.acquire(timeout=20)
            assert all((stage.ring.memory(k) == at_rest[k]).all() for k in slots), "written after it came back"
            whole += sum(arrival.complete for arrival in arrivals)
    finally:
        ending.set()
        pouring.join()
    assert whole > 0


def test_slots_change_hands_hundreds_of_times_and_nothing_piles_up(device: Plug, station: Make, opened: Open) -> None:
    """Each round is an arming: load, a pulse now and then, take back all the rest."""
    camera = device(0)
    camera.show(noise(1))
    stage = opened(station(camera))
    count = stage.ring.layout.slots_per_camera
    sizes = []
    for arming in range(600):
        stage.load(arming % 2)
        expected = stage.ring.slot(arming % 2, 0, 0)
        used = []
        if arming % 10 == 0:
            camera.fire(0)
            arrival = stage.arrival()
            assert arrival.complete, arrival.fault
            assert arrival.slot == expected, "slots are filled in the order they were queued"
            used = [arrival.slot]
        back = stage.cameras[0].take_back()
        assert sorted(used + back) == [stage.ring.slot(arming % 2, 0, k) for k in range(count)]
        if arming in (99, 599):
            sizes.append((resident_kib(), len(list(Path("/proc/self/fd").iterdir())), len(thread_names())))
    early, late = sizes
    assert late[1:] == early[1:]
    assert late[0] - early[0] < 1024, f"{late[0] - early[0]} KiB more after 500 armings"


def resident_kib() -> int:
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])
