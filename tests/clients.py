"""Clients in other languages, as docs/ prints them: compiled programs, and a bare HTTP connection."""

from __future__ import annotations

import os
import re
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.needs import need

DOCS = Path(__file__).resolve().parents[1] / "docs"
CSHARP = DOCS / "examples" / "csharp"
_REFERENCES = ("System.Net.Http", "System.Runtime.Serialization")


def compiled_csharp(folder: Path, name: str = "Tester") -> Path:
    """Compile the C# client with a program of docs/examples; a warning is an error."""
    need("mcs", "mono", *(f"{name}.dll" for name in _REFERENCES))
    program = folder / f"{name}.exe"
    references = [f"-r:{name}" for name in _REFERENCES]
    sources = [str(CSHARP / source) for source in ("VaoiStation.cs", f"{name}.cs")]
    command = ["mcs", "-warnaserror", "-warn:4", *references, f"-out:{program}", *sources]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return program


def run_csharp(program: Path, address: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the compiled program in its folder, in which it writes pictures."""
    return subprocess.run(
        ["mono", str(program), *arguments], cwd=program.parent, capture_output=True, text=True, timeout=120,
        check=False, env={**os.environ, "VAOI_STATION": address, **environment},
    )  # fmt: skip


class Answer(NamedTuple):
    """An answer as it came over the connection."""

    status: int
    headers: dict[str, str]
    """By names in lower case."""
    body: bytes


class BareConnection:
    """A kept connection that sends requests of HTTP 1.1 with the one header that it requires, `Host`, and no other."""

    def __init__(self, connection: socket.socket, host: str) -> None:
        self._connection, self._host = connection, host
        self._replies = connection.makefile("rb")

    def ask(self, method: str, path: str) -> Answer:
        """Send a request without a body; read the answer, whose length is known before its body."""
        self._connection.sendall(f"{method} {path} HTTP/1.1\r\nHost: {self._host}\r\n\r\n".encode("ascii"))
        status = int(self._replies.readline().split()[1])
        lines = iter(lambda: self._replies.readline().decode("ascii").strip(), "")
        headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)}
        return Answer(status, headers, self._replies.read(int(headers.get("content-length", "0"))))


@contextmanager
def bare_connection(address: str) -> Iterator[BareConnection]:
    """Open a connection to a station, `http://HOST:PORT`."""
    host, _, port = address.removeprefix("http://").partition(":")
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        yield BareConnection(connection, f"{host}:{port}")


def guide_sample(language: str) -> str:
    """Return the sample in one language of the guide for authors of tester software, as a reader gets it."""
    if language == "sh":
        [printed] = re.findall(
            r"^```sh\n(.*?)^```", (DOCS / "rest.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
        )
        return str(printed)
    name = {"python": "tester.py", "c": "c/tester.c"}[language]
    return (DOCS / "examples" / name).read_text(encoding="utf-8")


def plain_calls() -> list[tuple[str, str]]:
    """Return method and path of each call in the guide's table for LabVIEW."""
    guide = (DOCS / "rest" / "clients.md").read_text(encoding="utf-8")
    table = guide.partition("## LabVIEW")[2].partition("\n## ")[0]
    return re.findall(r"^\| \d+ \| `([A-Z]+) (\S+)` ", table, re.MULTILINE)


def make_plain_calls(connection: BareConnection, board_type: str) -> dict[str, Answer]:
    """Make the guide's calls one after another as a person would; return the answers by method and path as printed."""
    known = {"{board type}": board_type}
    found = {}
    for method, printed in plain_calls():
        path = printed
        for name, value in known.items():
            path = path.replace(name.replace(" ", "%20"), value).replace(name, value)
        answer = connection.ask(method, path)
        while answer.status == 204:  # the long poll: no board yet
            answer = connection.ask(method, path)
        if "/runs/next" in path:
            known["{run}"] = re.findall(rb'^{"id":"([^"]+)"', answer.body)[0].decode()
        found[f"{method} {printed}"] = answer
    return found
