"""What one caller may try to keep others out. Each attack runs until it is stopped, from an address of its own."""

from __future__ import annotations

import io
import json
import math
import secrets
import socket
import threading
import zipfile
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

ATTACKER = "127.0.0.66"
"""Source address of all attacks; the honest caller has 127.0.0.1."""
OUTSIDE = "X-Forwarded-For: 192.0.2.66\r\n"
"""Header with which a request counts as one from outside, so that it needs a key."""


HOST = "Host: localhost\r\n"

PREVIEWS = "/api/v1/board-data/previews?side=top&name=foreign&filename="
"""Where board data of CAD systems are uploaded; the name of the file follows."""
GROWN = 100_000_000
"""Bytes that an upload becomes when it is unpacked."""
CORNERS = 10_000
"""Corners of the large board types, which have a tenth as many fiducials and half as many components."""


class Target(NamedTuple):
    """A running station, or the proxy in front of it, and a run whose frames are in memory."""

    port: int
    run: str
    key: str = ""
    """Key of the attacker; a proxy passes on nothing without one."""


Attack = Callable[[Target, threading.Event], None]


def connect(target: Target, sent: bytes = b"") -> socket.socket:
    """Open a connection from the attacker's address and send bytes."""
    s = socket.socket()
    try:
        s.settimeout(2)
        s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        s.bind((ATTACKER, 0))
        s.connect(("127.0.0.1", target.port))
        if target.key and OUTSIDE.encode() not in sent:
            sent = sent.replace(b"Host: localhost\r\n", f"{HOST}Authorization: Bearer {target.key}\r\n".encode())
        s.sendall(sent)
    except OSError:
        s.close()
        raise
    return s


def get(path: str, headers: str = "") -> bytes:
    """Return a request."""
    return f"GET {path} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n".encode()


def post(method: str, path: str, body: bytes, length: int | None = None) -> bytes:
    """Return a request with a body; `length` is the length that it announces, by default the true one."""
    size = len(body) if length is None else length
    return f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {size}\r\n\r\n".encode() + body


def hold(target: Target, stop: threading.Event, sent: bytes, most: int, drip: bytes = b"") -> None:
    """Hold as many as `most` connections that have sent something and do not read; send `drip` on each in turn."""
    held: deque[socket.socket] = deque()
    while not stop.wait(0.002):
        with suppress(OSError):
            held.append(connect(target, sent))
        if drip and held:
            with suppress(OSError):
                held[0].send(drip)
            held.rotate()
        if len(held) > most:
            held.popleft().close()
    for s in held:
        s.close()


def ask(target: Target, stop: threading.Event, requests: Callable[[], bytes], pause_s: float = 0.0) -> None:
    """Send one request after the other, each on a new connection, and read the beginning of each answer."""
    while not stop.wait(pause_s):
        with suppress(OSError), connect(target, requests()) as s:
            s.recv(65536)


def held(sent: bytes, most: int, drip: bytes = b"") -> Attack:
    """Return an attack that holds connections on which it has sent something; RUN stands for the run in memory."""
    return lambda target, stop: hold(target, stop, sent.replace(b"RUN", target.run.encode()), most, drip)


def asked(sent: bytes) -> Attack:
    """Return an attack that sends one request again and again; RUN stands for the run in memory."""
    return lambda target, stop: ask(target, stop, lambda: sent.replace(b"RUN", target.run.encode()))


def large_board_types(target: Target, stop: threading.Event) -> None:
    """Store board types with 10,000 corners and 1,000 fiducials, each under another name."""
    turn = [2 * math.pi * i / CORNERS for i in range(CORNERS)]
    document = {
        "name": "NAME",
        "outline": [[100 * math.cos(t), 100 * math.sin(t)] for t in turn],
        "fiducials": [
            {"name": f"F{i}", "x": i % 32 - 16, "y": i // 32 - 16, "diameter": 0.2} for i in range(CORNERS // 10)
        ],
        "components": [
            {"ref": f"R{i}", "center": [i % 50, i // 50], "width": 1, "height": 1} for i in range(CORNERS // 2)
        ],
    }
    text, numbers = json.dumps(document), iter(range(10**9))

    def requests() -> bytes:
        name = f"flood-{next(numbers)}"
        return post("PUT", f"/api/v1/board-types/{name}", text.replace("NAME", name).encode())

    ask(target, stop, requests)


def overwritten_board_types(target: Target, stop: threading.Event) -> None:
    """Overwrite one board type again and again."""
    numbers = iter(range(10**9))

    def requests() -> bytes:
        part = {"ref": "U1", "center": [next(numbers), 2], "width": 3, "height": 4}
        fiducials = [{"name": f"F{k}", "x": 9 * k, "y": 7 * k, "diameter": 1} for k in range(2)]
        document = {"name": "again", "components": [part], "fiducials": fiducials}
        return post("PUT", "/api/v1/board-types/again", json.dumps(document).encode())

    ask(target, stop, requests)


def newest_runs(target: Target) -> list[str]:
    """Return the ids of the newest runs; their frames are in memory."""
    with suppress(OSError, ValueError), connect(target, get("/api/v1/runs?limit=3", "Connection: close\r\n")) as s:
        reply = b"".join(iter(lambda: s.recv(65536), b""))
        return [run["id"] for run in json.loads(reply.partition(b"\r\n\r\n")[2])["runs"]]
    return []


def pictures_of_every_run(target: Target, stop: threading.Event) -> None:
    """Ask for large pictures of all runs whose frames are in memory, so that none of them can be given to a board."""
    while not stop.is_set():
        for run in newest_runs(target):
            with suppress(OSError):
                connect(target, get(f"/api/v1/runs/{run}/components/U1/images/0?px_per_mm=200")).close()


def files_of_boards(target: Target, stop: threading.Event) -> None:
    """Ask for whole boards as files, of the newest run each time, and read only the beginning."""
    while not stop.wait(0.01):
        for run in newest_runs(target)[:1]:
            with suppress(OSError), connect(target, get(f"/api/v1/runs/{run}/mosaics/board.tif")) as s:
                s.recv(65536)


def planned_boards(target: Target, stop: threading.Event) -> None:
    """Ask for tiles of each new run, so that a worker plans a mosaic of every board; and for merged pictures."""
    while not stop.wait(0.01):
        for run in newest_runs(target):
            for what in ("mosaics/board_files/8/0_0.jpg", "merged?component=U1", "merged/image?component=U1"):
                with suppress(OSError), connect(target, get(f"/api/v1/runs/{run}/{what}")) as s:
                    s.recv(65536)


def guessed_keys(target: Target, stop: threading.Event) -> None:
    """Guess keys, in requests and in the login of the page."""

    def requests() -> bytes:
        key = f"vaoi_{secrets.token_hex(6)}_{secrets.token_urlsafe(32)}"
        if key[5] < "8":
            return get("/api/v1/station", f"{OUTSIDE}Authorization: Bearer {key}\r\n")
        return post("POST", "/api/v1/session", json.dumps({"key": key}).encode())

    ask(target, stop, requests)


def uploads_that_grow(target: Target, stop: threading.Event) -> None:
    """Upload archives of 100 kB whose content is a thousand times as large."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("job/matrix/matrix", bytes(GROWN))
    body = content.getvalue()
    ask(target, stop, lambda: post("POST", PREVIEWS + "job.zip", body))


def many_uploads(target: Target, stop: threading.Event) -> None:
    """Upload pick-and-place files with 20,000 parts, one after the other."""
    lines = [f"R{i},{i % 200},{i // 200},0,top,0603,10k" for i in range(CORNERS * 2)]
    body = "\n".join(["Ref,X,Y,Rotation,Side,Package,Value", *lines]).encode()
    ask(target, stop, lambda: post("POST", PREVIEWS + "b.csv", body))


_WHOLE_FRAME = get("/api/v1/runs/RUN/frames/0/1?format=raw")
ATTACKS: dict[str, Attack] = {
    # Half a head on each of 1,100 connections; then heads, bodies and uploads byte by byte.
    "half_heads": held(b"GET / HTTP/1.1\r\nHost: localhost\r\n", 1100),
    "slow_heads": held(b"GET / HTTP/1.1\r\nHost: localhost\r\nX-", 200, b"a"),
    "slow_bodies": held(post("PUT", "/api/v1/board-types/slow", b"{", 8_000_000), 200, b" "),
    "slow_uploads": held(post("POST", PREVIEWS + "b.txt", b"#", 50_000_000), 200, b" "),
    # Answers that are not read; few connections at a time are closed soon.
    "unread_answers": held(_WHOLE_FRAME, 80),
    "reconnections": held(_WHOLE_FRAME, 20),
    "event_streams": held(get("/api/v1/events?after=0"), 256),
    "long_polls": held(get("/api/v1/runs/next?timeout=60"), 256),
    "unread_trends": held(get("/api/v1/trends?points=2000&since=2017-01-01T00:00:00Z"), 80),
    "examinations": held(get("/api/v1/doctor"), 256),
    "camera_frames": held(get("/api/v1/cameras/0/frame"), 80),
    "kept_pictures": held(get("/api/v1/runs/RUN/mosaics/kept.jpg"), 80),
    # A search for a reason that no run has reads the whole history.
    "searches": held(get("/api/v1/runs?limit=500&reason=of-no-run&since=2017-01-01T00:00:00Z"), 80),
    "component_lists": held(get("/api/v1/runs/RUN/components"), 80),
    "public_documents": held(get("/api/v1/openapi.json", OUTSIDE), 256),
    "unread_batches": held(get("/api/v1/runs/RUN/images?container=zip"), 80),
    "board_checks": held(get("/api/v1/runs/RUN/board-check/picture"), 80),
    # Requests as fast as they are answered.
    "pictures": asked(get("/api/v1/runs/RUN/components/U1/images/0?px_per_mm=200")),
    "pictures_without_a_key": asked(get("/api/v1/runs/RUN/components/U1/images/0?px_per_mm=500", OUTSIDE)),
    "health_checks": asked(get("/readyz", OUTSIDE)),
    "large_board_types": large_board_types,
    "overwritten_board_types": overwritten_board_types,
    "pictures_of_every_run": pictures_of_every_run,
    "files_of_boards": files_of_boards,
    "planned_boards": planned_boards,
    "guessed_keys": guessed_keys,
    "uploads_that_grow": uploads_that_grow,
    "many_uploads": many_uploads,
}
