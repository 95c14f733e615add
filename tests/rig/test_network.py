"""Addresses and namespaces."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError
from vaoi_station.rig import network
from vaoi_station.rig.network import (
    NAMESPACE_VARIABLE,
    LoopbackAddresses,
    addresses,
    enter_namespace,
    isolation_command,
)

Program = Callable[[str, str], None]


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Program:
    """Put shell scripts in place of all programs of this machine: `program(name, body)`."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))

    def write(name: str, body: str) -> None:
        (folder / name).write_text(f"#!/bin/sh\n{body}\n")
        (folder / name).chmod(0o755)

    return write


@pytest.fixture
def calls(tmp_path: Path, program: Program) -> Callable[[], list[str]]:
    """An `ip` that knows 127.0.0.2, records what it is called with and refuses 127.0.0.99."""
    log = tmp_path / "calls"
    log.touch()
    program(
        "ip",
        f"""echo "$@" >> {log}
        case "$*" in
          *-oneline*) echo '1: lo    inet 127.0.0.1/8 scope host lo'; echo '1: lo    inet 127.0.0.2/8 scope host lo';;
          *add*127.0.0.99/8*) echo 'Operation not permitted' >&2; exit 2;;
        esac""",
    )
    return lambda: [line for line in log.read_text().splitlines() if " add " in line or " del " in line]


def test_missing_addresses_are_added_and_only_these_are_removed(calls: Callable[[], list[str]]) -> None:
    with LoopbackAddresses(addresses(3)):
        assert calls() == ["addr add 127.0.0.3/8 dev lo", "addr add 127.0.0.4/8 dev lo"]
    assert calls()[2:] == ["addr del 127.0.0.4/8 dev lo", "addr del 127.0.0.3/8 dev lo"]


def test_a_refused_address_takes_the_others_with_it(calls: Callable[[], list[str]]) -> None:
    with (
        pytest.raises(DeviceError, match=r"`ip addr add 127\.0\.0\.99/8 dev lo` was refused: Operation not permitted"),
        LoopbackAddresses(["127.0.0.3", "127.0.0.99"]),
    ):
        pass
    assert calls()[-1] == "addr del 127.0.0.3/8 dev lo"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("exit 0", ["unshare", "--net"]),
        ('case "$*" in *--map-root-user*) exit 0;; *) exit 1;; esac', ["unshare", "--map-root-user", "--net"]),
        ("exit 1", []),
    ],
)
def test_the_weakest_sufficient_isolation_is_chosen(program: Program, body: str, expected: list[str]) -> None:
    program("unshare", body)
    assert isolation_command() == expected


@pytest.mark.parametrize(
    ("isolation", "kind"),
    [(["unshare", "--net"], "net"), (["unshare", "--map-root-user", "--net"], "user")],
)
def test_the_command_starts_again_inside_the_namespace(
    monkeypatch: pytest.MonkeyPatch, isolation: list[str], kind: str
) -> None:
    started: list[tuple[list[str], str]] = []

    def execute(_: str, command: list[str], environment: dict[str, str]) -> None:
        started.append((command, environment[NAMESPACE_VARIABLE]))

    monkeypatch.delenv(NAMESPACE_VARIABLE, raising=False)
    monkeypatch.setattr(network, "isolation_command", lambda: isolation)
    monkeypatch.setattr(os, "execvpe", execute)
    monkeypatch.setattr(sys, "argv", ["vaoi", "rig", "run", "--boards", "1"])
    enter_namespace()
    assert started == [([*isolation, sys.executable, "-m", "vaoi_station", "rig", "run", "--boards", "1"], kind)]
