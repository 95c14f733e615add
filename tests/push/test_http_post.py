"""A POST request is bounded whatever the receiver does, and goes to permitted addresses only."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from tests.peers.certificates import make_authority, make_certificate
from tests.push.receiving import Receiver, peer, receiver
from vaoi_station.push import http_post
from vaoi_station.push.http_post import NotDeliveredError, Reply, Route, post, refusal

PATIENT, SHORT = Route(None, (), 30.0), Route(None, (), 0.3)


def test_status_and_retry_after_are_returned(target: Receiver) -> None:
    target.status, target.headers = 503, {"Retry-After": "120"}
    assert post(target.url, {"X-A": "b"}, b"{}", PATIENT) == Reply(503, 120.0)
    request = target.next()
    assert request.body == b"{}"
    assert request.headers["x-a"] == "b"
    assert request.headers["host"] == target.url.split("/")[2]


def test_a_redirect_is_an_answer_and_is_not_followed(target: Receiver) -> None:
    target.status, target.headers = 307, {"Location": target.url}
    assert post(target.url, {}, b"", PATIENT).status == 307
    target.next()
    assert target.got.empty()


def _endless_head(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 4000)


def _drip(connection: socket.socket) -> None:
    ended = threading.Event()
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    while not ended.wait(0.01):
        connection.sendall(b"x")


@pytest.mark.parametrize(
    ("talk", "fault"),
    [
        (_endless_head, "larger than 16 KiB"),
        (_drip, "no answer within 0 s"),
        (lambda c: c.recv(1), "no answer within 0 s"),
        (lambda c: None, "closed before the answer"),
        (lambda c: c.sendall(b"SSH-2.0-x\r\n\r\n"), "is not HTTP"),
        (lambda c: c.sendall(b"HTTP/1.1 20\r\n\r\n"), "is not HTTP"),
    ],
    ids=["endless head", "byte by byte", "silent", "closed", "another protocol", "status cut short"],
)
def test_a_hostile_receiver_is_bounded(talk: Callable[[socket.socket], object], fault: str) -> None:
    with peer(talk) as url, pytest.raises(NotDeliveredError, match=fault):
        post(url, {}, b"", SHORT)


def test_an_interim_answer_is_passed_over_and_a_huge_one_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_post, "DRAIN_S", 0.2)

    def talk(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 103 Early Hints\r\nLink: x\r\n\r\nHTTP/1.1 202 Accepted\r\n\r\n")
        for _ in range(10_000):
            connection.sendall(bytes(65536))

    with peer(talk) as url:
        assert post(url, {}, b"", PATIENT).status == 202


def test_a_closed_port_and_an_unknown_name_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(NotDeliveredError, match=f"127.0.0.1 port {port}: Connection refused"):
        post(f"http://127.0.0.1:{port}/", {}, b"", PATIENT)

    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(NotDeliveredError, match=r"the name no\.such\.invalid has no address \(Name or"):
        post("http://no.such.invalid/", {}, b"", PATIENT)


def test_tls_is_verified(tmp_path: Path) -> None:
    authority = make_authority(tmp_path)
    with receiver(make_certificate(tmp_path, authority=authority)) as target:
        trusting = ssl.create_default_context(cafile=str(authority.certificate))
        assert post(target.url, {}, b"{}", Route(trusting, (), 30.0)).status == 204
        with pytest.raises(NotDeliveredError, match=r"certificate of 127\.0\.0\.1 is not trusted"):
            post(target.url, {}, b"{}", Route(ssl.create_default_context(), (), 30.0))
    with peer(lambda c: c.sendall(b"no TLS")) as url, pytest.raises(NotDeliveredError):
        post(url.replace("http:", "https:"), {}, b"{}", Route(ssl.create_default_context(), (), 30.0))


@pytest.mark.parametrize(
    ("address", "networks", "permitted"),
    [
        ("127.0.0.1", (), True),
        ("10.1.2.3", (), True),
        ("8.8.8.8", (), True),
        ("::1", (), True),
        ("169.254.169.254", (), False),
        ("::ffff:169.254.169.254", (), False),
        ("2002:a9fe:a9fe::1", (), False),
        ("64:ff9b::a9fe:a9fe", (), False),
        ("64:ff9b::c0a8:102", ("192.168.1.0/24",), True),
        ("fe80::1%eth0", (), False),
        ("224.0.0.1", (), False),
        ("0.0.0.0", (), False),  # noqa: S104  nothing binds to it
        ("169.254.1.2", ("169.254.0.0/16",), True),
        ("10.1.2.3", ("10.0.0.0/8", "::1/128"), True),
        ("127.0.0.1", ("10.0.0.0/8",), False),
    ],
)
def test_addresses_are_permitted_by_network(address: str, networks: tuple[str, ...], permitted: bool) -> None:
    assert (refusal(address, networks) == "") is permitted


def test_the_address_that_a_name_leads_to_is_what_counts(target: Receiver) -> None:
    url = target.url.replace("127.0.0.1", "localhost")
    with pytest.raises(NotDeliveredError, match=r"is in none of push\.networks"):
        post(url, {}, b"", Route(None, ("192.0.2.0/24",), 30.0))
    assert target.got.empty()
