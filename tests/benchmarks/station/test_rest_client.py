from __future__ import annotations

import threading
from urllib.parse import urlsplit

import pytest

from tests.peers.web_server import ScriptedHandler, serving
from vaoi_station.benchmarks.station.rest_client import callers, read_batch
from vaoi_station.errors import DeviceError


class Pictures(ScriptedHandler):
    """Pictures, of which one is refused, and two batches, of which one ends early."""

    protocol_version = "HTTP/1.1"
    fetched = threading.Semaphore(0)

    def do_GET(self) -> None:  # noqa: N802  (as http.server calls it)
        self.fetched.release()
        batch = b"x" * 3_000_000 + b'{"complete":%s}' % (b"false" if "early" in self.path else b"true")
        self.send(410 if "gone" in self.path else 200, batch if "batch" in self.path else b"pixels")


def port_of(url: str) -> int:
    port = urlsplit(url).port
    assert port is not None
    return port


def test_callers_fetch_all_pictures_again_and_again() -> None:
    with serving(Pictures) as url, callers(port_of(url), ["/a", "/b", "/c"], 2) as fetched:
        for _ in range(6):
            assert Pictures.fetched.acquire(timeout=60)
    assert len(fetched) > 3
    assert all(f.ms > 0 for f in fetched)
    assert {f.path for f in fetched} <= {"/a", "/b", "/c"}


def test_a_busy_station_is_asked_again_after_its_pause() -> None:
    class Busy(Pictures):
        fetched = threading.Semaphore(0)
        refusals = iter([503, 503])

        def do_GET(self) -> None:  # noqa: N802  (as http.server calls it)
            self.fetched.release()
            self.send(next(self.refusals, 200), b"pixels", retry_after="0.05")

    with serving(Busy) as url, callers(port_of(url), ["/a"], 1) as fetched:
        for _ in range(4):
            assert Busy.fetched.acquire(timeout=60)
    assert fetched[0].ms > 100, "both pauses are part of the time that the caller waits"


def test_a_batch_is_read_to_its_end() -> None:
    with serving(Pictures) as url:
        batch = read_batch(port_of(url), "/batch")
    assert batch.complete
    assert batch.mbytes == pytest.approx(3, rel=0.01)
    assert 0 < batch.first_byte_ms <= batch.total_s * 1e3


def test_a_refusal_ends_the_measurement() -> None:
    class Refusals(Pictures):
        fetched = threading.Semaphore(0)

    refused = pytest.raises(DeviceError, match=r"/gone: b'pixels'")
    with serving(Refusals) as url, refused, callers(port_of(url), ["/gone"], 1):
        assert Refusals.fetched.acquire(timeout=60)


def test_a_batch_that_ends_early_is_not_complete() -> None:
    with serving(Pictures) as url:
        assert not read_batch(port_of(url), "/early/batch").complete
