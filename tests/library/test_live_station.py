"""A station over a real socket through the public API."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.peers.certificates import Certificate, make_authority, make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile


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


def test_runs_are_listed_and_waited_for(served: Served) -> None:
    station = vaoi.connect(served.url)
    assert [run["id"] for run in station.runs()] == ["r000001"]
    assert station.wait_for_run(after="r000001", timeout_s=0.0) is None
    second = served.station.film()
    following = station.wait_for_run(after="r000001", timeout_s=5.0)
    assert following is not None
    assert following.id == second
    assert station.snapshot()["state"]


def test_refusals_are_the_errors_of_the_station(served: Served) -> None:
    station = vaoi.connect(served.url)
    with pytest.raises(vaoi.NotFoundError):
        station.run("r999999")
    with pytest.raises(vaoi.NotFoundError, match="U999"):
        station.run().component("U999")


def test_an_address_without_a_station_is_refused() -> None:
    with pytest.raises(vaoi.InputError, match="must start with http"):
        vaoi.connect("localhost:8350")
    with pytest.raises(vaoi.DeviceError, match="does not reply"):
        vaoi.connect("http://127.0.0.1:9")


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


def test_released_frames_are_gone(served: Served) -> None:
    run = vaoi.connect(served.url).run()
    images = run.component("U1")
    run.release()
    with pytest.raises(vaoi.GoneError):
        _ = images[0].pixels


def test_the_line_is_armed_and_disarmed(served: Served) -> None:
    station = vaoi.connect(served.url)
    assert station.arm("demo-board", board_id="SN-2", job_id="J", runs=3)["state"] == "armed"
    assert served.station.armed is not None
    assert (served.station.armed.job_id, served.station.armed.runs_left) == ("J", 3)
    assert station.disarm()["state"] == "idle"
    with pytest.raises(vaoi.InputError, match="arm"):
        station.arm("demo-board", runs=0)
    served.station.lose(1)
    with pytest.raises(vaoi.VaoiError) as refused:
        station.arm("demo-board")
    assert refused.value.code == "camera-lost"
    assert station.arm("demo-board", allow_lost_cameras=True)["state"] == "armed"


def test_events_follow_the_newest_one_known(served: Served) -> None:
    station = vaoi.connect(served.url)
    after = station.snapshot()["last_event"]
    run = served.station.film()
    events = [next(e for e in station.events(after) if e.get("state") == "ready")]
    assert events[0]["run"] == run
