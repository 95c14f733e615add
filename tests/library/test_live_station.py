"""A station over a real socket through the public API: its line, its runs and its board types."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.peers.certificates import Certificate, make_authority, make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.library import live_station


def test_the_latest_run_gives_images_of_a_component(served: Served) -> None:
    run = vaoi.connect(served.url).run()
    assert run.summary["board_id"] == "SN-1"
    assert run.status == vaoi.Status.OK
    assert run.refs == ("U1", "R1", "2/R1")
    images = run.component("U1")
    assert images.images
    for image in images:
        assert image.pixels.shape[:2] == (64, 80), "8 mm × 10 mm at 8 px/mm"
        assert image.crop_from_cad.shape == image.image_from_crop.shape == (3, 3)


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[tuple[Served, Certificate, str]]:
    """A station with TLS that asks for a key on loopback too, its authority, and a key that may read."""
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    authority = make_authority(tmp_path)
    station = HeldStation()
    station.film()
    # Served trusts the certificate itself; the tests trust the authority.
    certificate = make_certificate(tmp_path, "station", authority)
    chain = tmp_path / "chain.pem"
    chain.write_text(certificate.certificate.read_text() + authority.certificate.read_text())
    access = AccessControl(keys, audit, open_loopback=False)
    served = Served(station, access=access, certificate=Certificate(chain, certificate.private_key))
    yield served, authority, keys.create("reader", ["read"]).secret
    served.client.close()  # its open connection would have 5 s to end
    served.stop()
    audit.close()


def test_a_station_with_keys_and_tls_is_used_with_a_key_file_and_its_authority(
    closed: tuple[Served, Certificate, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served, authority, secret = closed
    (tmp_path / "key").write_text(secret + "\n")
    station = vaoi.connect(served.url, key_file=tmp_path / "key", ca=authority.certificate)
    assert station.run().component("U1").images[0].pixels.ndim == 2
    monkeypatch.setenv("VAOI_KEY_FILE", str(tmp_path / "key"))
    monkeypatch.setenv("VAOI_CA", str(authority.certificate))
    assert vaoi.connect(served.url).snapshot()["state"]
    with pytest.raises(vaoi.InputError, match="needs the scope operate") as refusal:
        station.run().release()
    assert refusal.value.code == "missing-scope"


def test_a_missing_key_and_an_unknown_authority_are_refused(closed: tuple[Served, Certificate, str]) -> None:
    served, authority, secret = closed
    with pytest.raises(vaoi.InputError, match="needs a key") as refusal:
        vaoi.connect(served.url, ca=authority.certificate)
    assert refusal.value.code == "no-key"
    with pytest.raises(vaoi.DeviceError, match=r"(?i)certificate.verify.failed"):
        vaoi.connect(served.url, key=secret)
    with pytest.raises(vaoi.InputError, match="key is 'bytes'"):
        vaoi.connect(served.url, key=secret.encode())  # type: ignore[arg-type]


def test_the_line_is_armed_and_disarmed(served: Served) -> None:
    station = vaoi.connect(served.url)
    assert station.arm("demo-board", board_id="SN-2", job_id="J", runs=3)["state"] == "armed"
    assert served.station.armed is not None
    assert (served.station.armed.job_id, served.station.armed.runs_left) == ("J", 3)
    assert station.disarm()["state"] == "idle"
    with pytest.raises(vaoi.InputError, match="runs"):
        station.arm("demo-board", runs=0)
    served.station.lose(1)
    with pytest.raises(vaoi.VaoiError) as refused:
        station.arm("demo-board")
    assert refused.value.code == "camera-lost"
    assert station.arm("demo-board", allow_lost_cameras=True)["state"] == "armed"


@pytest.fixture(scope="module")
def run() -> Iterator[vaoi.StationRun]:
    station = HeldStation()
    station.film(board_id="SN-1")
    served = Served(station)
    yield vaoi.connect(served.url).run()
    served.stop()


def test_the_verdict_of_the_run_counts_with_its_reasons(run: vaoi.StationRun) -> None:
    """A board id that differs degrades the run, not its matrices."""
    assert (run.status, run.reasons) == ("ok", run.result.reasons)
    differs = {"code": "board-id-differs", "message": "The code states SN-2."}
    degraded = replace(run, summary=run.summary | {"verdict": "degraded", "reasons": [differs]})
    assert degraded.result.status == "ok"
    assert (degraded.status, degraded.reasons) == ("degraded", (*run.result.reasons, "The code states SN-2."))


@pytest.mark.parametrize(("awaited_s", "fetched"), [(10.0, 3), (0.0, 1)])
def test_entries_that_a_result_still_lacks_are_awaited_for_a_time(
    run: vaoi.StationRun, monkeypatch: pytest.MonkeyPatch, awaited_s: float, fetched: int
) -> None:
    monkeypatch.setattr(live_station, "_AWAITED_S", awaited_s)
    first = run.result.model_copy(update={"quality": {**run.result.quality, "later": ["heights_mm"]}})
    client = Mock(read=Mock(return_value=first))
    own = vaoi.StationRun("r1", {}, client)
    for _ in range(3):
        assert own.result is first
    assert client.read.call_count == fetched


def test_a_result_that_was_fetched_early_is_fetched_again_however_late(
    run: vaoi.StationRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, now_s = run.result, 1000.0
    monkeypatch.setattr(live_station, "time", SimpleNamespace(monotonic=lambda: now_s))
    first = whole.model_copy(update={"quality": {**whole.quality, "later": ["heights_mm"]}})
    client = Mock(read=Mock(side_effect=[first, whole]))
    own = vaoi.StationRun("r1", {}, client)
    assert "later" in own.result.quality
    now_s += 60
    assert "later" not in own.result.quality


def test_two_files_that_are_written_at_once_are_both_complete(tmp_path: Path) -> None:
    target = tmp_path / "board.tif"

    class Reply(io.BytesIO):
        headers: Mapping[str, str] = {"Content-Length": "5"}

        def read(self, size: int | None = -1) -> bytes:
            if replies:
                run.save_mosaic("all", target)
                assert target.read_bytes() == b"other"
            return super().read(size)

    replies = [Reply(b"other"), Reply(b"first")]
    client = Mock(opened=lambda *_, **__: nullcontext(replies.pop()))
    run = vaoi.StationRun("r1", {}, client)
    run.save_mosaic("all", target)
    assert target.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [target]


async def whole_cycle(served: Served) -> None:
    station = await vaoi.connect_async(served.url)
    assert (await station.arm("demo-board", board_id="SN-2", runs=1))["state"] == "armed"
    assert served.station.armed is not None
    assert served.station.armed.board_id == "SN-2"
    latest = await station.run()
    assert latest.summary["board_id"] == "SN-1"
    waiting = asyncio.create_task(station.wait_for_run(after=latest.id, timeout_s=30.0))
    second = await asyncio.to_thread(served.station.film)
    following = await waiting
    assert following is not None
    assert following.id == second
    assert (await following.result()).status == vaoi.Status.OK
    assert [image.pixels.shape for image in await following.component("U1", limit=1)] == [(64, 80)]
    assert {found.address async for found in following.pictures(limit=1)} == {"U1", "R1", "2/R1"}
    await following.hold("tester", "reads pictures")
    assert (second, "tester") in served.station.holders
    await following.release("tester")
    assert not served.station.run(second).frames_available
    assert (await station.disarm())["state"] == "idle"
    assert [run["id"] for run in await station.runs()] == [second, latest.id]


def test_a_tester_s_whole_cycle(served: Served) -> None:
    asyncio.run(whole_cycle(served))


def test_events_as_they_happen(served: Served) -> None:
    async def first_run() -> str:
        station = await vaoi.connect_async(served.url)
        after = (await station.snapshot())["last_event"]
        served.station.film()
        async for event in station.events(after):
            if event.get("state") == "ready":
                return str(event["run"])
        raise AssertionError("the station ended its events")

    assert asyncio.run(first_run()) == "r000002"


@pytest.mark.parametrize("region", [None, "1234", (1, 2, 3), (1, 2, 3, 4, 5), (0, 0, float("nan"), 1)])
def test_a_region_that_is_no_box_is_refused_before_the_request(run: vaoi.StationRun, region: Any) -> None:
    with pytest.raises(vaoi.InputError, match="four numbers"):
        run.region(region)
