"""`vaoi bundle`: the information that a developer needs about a fault, in one tar file without secrets and pictures."""

from __future__ import annotations

import hashlib
import http.client
import io
import json
import platform
import re
import sqlite3
import subprocess
import tarfile
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import NamedTuple

from vaoi_station.config import StationConfig, read_config
from vaoi_station.doctor.finding import problems_as_text
from vaoi_station.doctor.runner import check_config, run_checks
from vaoi_station.doctor.running_station import ask, request
from vaoi_station.errors import VaoiError
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.files.directories import refuse_existing
from vaoi_station.files.documents import read_text, write_bytes
from vaoi_station.version import __version__

UNIT = "vaoi-station"
REMOVED = "[removed]"
TIMEOUT_S = 20.0
LARGEST_REPLY, MOST_EVENTS = 50_000_000, 1000
_HEARTBEAT = b"event: heartbeat"
PATHS = {
    "station.json": "/api/v1/station",
    "runs.json": "/api/v1/runs?limit=100",
    "calibration-status.json": "/api/v1/calibration",
    "metrics.txt": "/metrics",
}
"""Members of the bundle that come from a running station, with their REST paths."""
COMMANDS = {
    "journal.txt": ("journalctl", "-u", UNIT, "-n", "20000", "-o", "short-iso-precise", "--no-pager"),
    "unit.txt": ("systemctl", "show", "--no-pager", UNIT),
    "disk.txt": ("df", "-h"),
    "network.txt": ("ip", "-brief", "address"),
    "usb.txt": ("lsusb",),
}
MACHINE_FILES = ("etc/os-release", "proc/version", "proc/meminfo", "proc/loadavg", "proc/mounts", "proc/uptime")

_MISSING = "not available: "
_CAUSE = re.compile(rf"(?:{_MISSING}|status \d+: ).{{0,200}}")
"""The first line of a member without its content, such as a refusal of the running station."""

_WORDS = (
    r"[\w.-]*(?:pass(?:word|wd|phrase)|secret|token|credential|api[-_]?key|private[-_]?key|authorization|cookie)[\w.-]*"
)
_SECRETS = (
    re.compile(rf"(?i)(?P<before>[\"']?\b{_WORDS}[\"']?\s*[=:]\s*)(?P<secret>\[[^\]]*\]|\"[^\"]*\"|'[^']*'|[^\n]+)"),
    # A key of a station, and the cookie of a login, wherever they stand.
    re.compile(r"(?P<before>)(?P<secret>\bvaoi_[0-9a-f]{6,}_[\w-]+)"),
    re.compile(r"(?P<before>)(?P<secret>\bwhsec_[A-Za-z0-9+/=]{8,})"),
    re.compile(r"(?i)(?P<before>\bvaoi-session[\"']?\s*[=:]\s*)(?P<secret>[^\s;,]+)"),
    re.compile(r"(?i)(?P<before>\b(?:bearer|basic)\s+)(?P<secret>[\w.~+/=-]{8,})"),
    re.compile(r"(?P<before>\w://)(?P<secret>[^/\s:@]+:[^/\s@]+)(?=@)"),
    # The address of a receiver is often a secret from its path on: chat services take messages from all who know it.
    re.compile(r"(?i)(?P<before>\burl[\"']?\s*[=:]\s*[\"']?https?://[^/?\s\"']+)(?P<secret>[/?][^\s\"']+)"),
    re.compile(r"(?i)(?P<before>[?&](?:key|sig|signature|code|auth)=)(?P<secret>[^\s&\"')]+)"),
    re.compile(
        r"(?P<before>)(?P<secret>-----BEGIN [A-Z ]*PRIVATE KEY-----.*?-----END [A-Z ]*PRIVATE KEY-----)", re.DOTALL
    ),
)
"""Patterns: values of keys whose names suggest a secret, HTTP credentials, credentials in addresses, private keys."""


def without_secrets(text: str) -> str:
    """Return a text in which everything that looks like a secret is replaced by `REMOVED`."""
    for pattern in _SECRETS:
        text = pattern.sub(lambda match: f"{match['before']}{REMOVED}", text)
    return text


class Bundle(NamedTuple):
    """What a bundle has: its members, and why some of them have not what they are for."""

    members: list[str]
    missing: dict[str, str]
    """First line of each member that states a cause in place of its content."""


def write_support_bundle(config: Path, out: Path, credentials: CallerCredentials | None = None) -> Bundle:
    """Write the bundle of a station as a new .tar.gz file; return what it has.

    In place of anything that cannot be read, the bundle states the cause.
    """
    refuse_existing(out)
    members = {name: without_secrets(content) for name, content in _members(config, credentials)}
    missing = {name: found[0] for name, content in sorted(members.items()) if (found := _CAUSE.match(content))}
    members["README.txt"] = _readme(members, missing)
    folder, packed = out.name.removesuffix(".gz").removesuffix(".tar"), io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as tar:
        for name, content in sorted(members.items()):
            data = content.encode("utf-8", "replace")
            entry = tarfile.TarInfo(f"{folder}/{name}")
            entry.size, entry.mtime, entry.mode = len(data), int(time.time()), 0o640
            tar.addfile(entry, io.BytesIO(data))
    write_bytes(out, packed.getvalue())
    return Bundle(sorted(members), missing)


def _members(path: Path, credentials: CallerCredentials | None) -> Iterator[tuple[str, str]]:
    yield "station.toml", _attempt(lambda: read_text(path, "replace"))
    yield "check-config.txt", _attempt(lambda: problems_as_text(path, check_config(path)))
    yield "doctor.json", _attempt(lambda: json.dumps(run_checks(path, credentials=credentials).document(), indent=1))
    for name in MACHINE_FILES:
        yield f"machine/{Path(name).name}.txt", _attempt((Path("/") / name).read_text)
    for name, command in COMMANDS.items():
        yield name, _attempt(partial(_output, command))
    try:
        config = read_config(path)
    except VaoiError:
        yield "files.txt", f"{_MISSING}files, database and address are those of a station.toml without faults\n"
        return
    yield "calibration.json", _attempt(lambda: read_text(config.calibration, "replace"))
    yield "files.txt", _attempt(lambda: "\n".join(_listing(config)))
    yield "database.txt", _attempt(lambda: "\n".join(_database(config.data / "station.db")))
    yield "running/events.txt", _attempt(partial(_events, config, credentials))
    for name, address in PATHS.items():
        yield f"running/{name}", _attempt(partial(_reply, config, address, credentials))


def _attempt(read: Callable[[], str]) -> str:
    try:
        return read()
    except Exception as error:  # noqa: BLE001  (a bundle is made because something is broken; each part stands alone)
        return f"{_MISSING}{type(error).__name__}: {error}\n"


def _output(words: tuple[str, ...]) -> str:
    done = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    return done.stdout + done.stderr


def _reply(config: StationConfig, path: str, credentials: CallerCredentials | None) -> str:
    status, content = request(config.api, path, TIMEOUT_S, LARGEST_REPLY, credentials, _all_events_read)
    return f"{'' if status == http.client.OK else f'status {status}: '}{content.decode('utf-8', 'replace')}"


def _events(config: StationConfig, credentials: CallerCredentials | None) -> str:
    newest = ask(config.api, credentials)["last_event"]
    return _reply(config, f"/api/v1/events?after={max(0, newest - MOST_EVENTS)}", credentials)


def _all_events_read(content: bytes) -> bool:
    # The stream begins with a heartbeat, and has the next one when no further event is there.
    return content.startswith(_HEARTBEAT) and content.count(b"\n" + _HEARTBEAT) > 0


def _listing(config: StationConfig) -> Iterator[str]:
    """Yield size, time, digest and path of the files that the configuration names. Layouts of boards are not copied."""
    for file in (config.calibration, *sorted(config.board_types.glob("*.json"))):
        yield _described(file, digest=True)
    for file in sorted(config.data.glob("*")):
        yield _described(file)


def _described(file: Path, *, digest: bool = False) -> str:
    """Return the line of a file, also if it is absent: a running station deletes files meanwhile."""
    try:
        state, content = file.stat(), file.read_bytes() if digest else b""
    except FileNotFoundError:
        return f"{'absent':>12} {'':<25} {'':<16} {file}"
    if not digest:
        return f"{state.st_size:>12} {'':<25} {'':<16} {file}"
    changed = datetime.fromtimestamp(state.st_mtime, UTC).isoformat(timespec="seconds")
    return f"{state.st_size:>12} {changed} {hashlib.sha256(content).hexdigest()[:16]} {file}"


def _database(path: Path) -> Iterator[str]:
    """Yield schema version and number of rows of each table. The database is opened for reading only."""
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=5)
    try:
        yield f"user_version {connection.execute('PRAGMA user_version').fetchone()[0]}"
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name").fetchall()
        for (table,) in tables:
            count = connection.execute(f'SELECT count(*) FROM "{table}"').fetchone()[0]
            yield f"{count:>9} {table}"
    finally:
        connection.close()


def _readme(members: dict[str, str], missing: dict[str, str]) -> str:
    removed = {name: count for name, text in members.items() if (count := text.count(REMOVED))}
    return "\n".join(
        [
            f"Support bundle of vaoi_station {__version__}, made {datetime.now(UTC).isoformat(timespec='seconds')}",
            f"on {platform.node()}, Python {platform.python_version()}.",
            "",
            "It has no pictures, no results and no layouts of boards; secrets were removed by their names:",
            *(f"  {name}: {count}" for name, count in sorted(removed.items())),
            *(["  none found"] if not removed else []),
            *(["What could not be read:"] if missing else []),
            *(f"  {name}: {cause}" for name, cause in missing.items()),
            "Read it before you send it: host names, addresses and names of board types are in it.",
            "",
        ]
    )
