"""The C# client of docs/examples: keys, TLS, refusals, and commands whose reply is lost."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tests.api.held_station import HeldStation
from tests.clients import compiled_csharp, run_csharp
from tests.peers.certificates import make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.model.board_type import PointTable


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled_csharp(tmp_path_factory.mktemp("csharp"))


@pytest.fixture
def guarded(tmp_path: Path, serve: Callable[..., Any]) -> Iterator[tuple[Any, Path, KeyFile]]:
    """Return a station that needs a key and has a certificate of its own, that certificate, and the keys."""
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    certificate = make_certificate(tmp_path)
    served = serve(HeldStation(), access=AccessControl(keys, audit, open_loopback=False), certificate=certificate)
    yield served, certificate.certificate, keys
    served.stop()
    audit.close()


def test_a_key_and_the_certificate_of_the_station_let_it_in(program: Path, guarded: Any) -> None:
    served, certificate, keys = guarded
    reader = keys.create("reader", ["read"]).secret
    # Armed with a key of the scope read: it is let in, and refused by the name of what it lacks.
    done = run_csharp(program, served.url, "demo-board", "U1", VAOI_KEY=reader, VAOI_CA=str(certificate))
    assert (done.returncode, done.stdout) == (1, "")
    assert re.match(r"missing-scope: POST /api/v1/station/arm needs the scope operate; key reader has", done.stderr)


def test_a_clamped_board_is_probed_at_the_test_points_of_a_net(tmp_path: Path, served: Any) -> None:
    prober = compiled_csharp(tmp_path, "Prober")
    board = served.station.types["demo-board"]
    points = PointTable(name=("U1-1", "U1-2"), x=(20.0, 21.0), y=(20.0, 20.0), net=("GND", "3V3"))
    served.station.types["demo-board"] = board.model_copy(update={"test_points": points})
    served.station.film()
    done = run_csharp(prober, served.url, "30", "GND")
    # A turn by 30° about the origin, then a shift by (400, 250).
    assert done.returncode == 0, done.stderr
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("U1-"))
    x, y = re.fullmatch(r"U1-1 \(GND\): x (\S+) y (\S+) z .* mm", line).groups()  # type: ignore[union-attr]
    assert (float(x), float(y)) == pytest.approx((407.3205, 277.3205), abs=2e-2)
    assert "keep out U1, height unknown" in done.stdout
    refused = run_csharp(prober, served.url, "30", "VCC")
    assert refused.stderr.startswith("invalid-input: "), refused.stderr


def test_a_refusal_has_code_detail_and_action(program: Path, served: Any) -> None:
    done = run_csharp(program, served.url, "unheard", "U1")
    assert done.stderr == "unknown-board-type: There is no board type 'unheard'. Teach it.\n"


def test_a_command_whose_reply_is_lost_is_repeated_with_its_key(program: Path) -> None:
    """A scripted station that closes the connection in place of the first reply to each request."""
    received: list[str] = []

    def answer(listener: socket.socket) -> None:
        with listener:  # closed after the last reply, so that further requests fail at once
            for reply in (b'{"id":"r1"}', b'{"state":"armed"}'):
                for sent in (b"", reply):
                    connection, _ = listener.accept()
                    with connection:
                        received.append(connection.recv(10_000).decode("ascii"))
                        if sent:
                            head = f"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: {len(sent)}\r\n\r\n"
                            connection.sendall(head.encode() + sent)

    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    with ThreadPoolExecutor(1) as pool:
        answering = pool.submit(answer, listener)
        run_csharp(program, f"http://127.0.0.1:{port}", "demo-board", "U1")
        answering.result()
    armed = [r for r in received if r.startswith("POST /api/v1/station/arm?board_type=demo-board&job_id=guide ")]
    keys = {key for r in armed for key in re.findall(r'^Idempotency-Key: ("[0-9a-f-]{36}")\r$', r, re.MULTILINE)}
    assert len(armed) == 2
    assert len(keys) == 1
