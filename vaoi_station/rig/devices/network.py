"""Room for virtual cameras: addresses on loopback, in a network namespace of our own where the kernel gives one.

GigE Vision has one UDP port, so two cameras cannot share an address, and two rigs not the same addresses. In a
namespace nobody collides, and everything is gone with the last process in it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence

from vaoi_station.errors import DeviceError, InputError

FIRST = (127, 0, 0, 2)
MOST = 200
"""Cameras of one rig."""
INSIDE = "VAOI_RIG_NETWORK"
"""Set where we are in a namespace of our own already; `user` if a user namespace belongs to it."""


def addresses(count: int) -> tuple[str, ...]:
    """One per camera.

    Raises:
        InputError: more than there is room for.
    """
    if not 1 <= count <= MOST:
        raise InputError.field("vaoi rig", "--cameras", count, f"from 1 to {MOST}")
    a, b, c, d = FIRST
    return tuple(f"{a}.{b}.{c}.{d + k}" for k in range(count))


def isolation() -> list[str]:
    """What to write before a command so that it runs in a network of its own; empty if the kernel gives none.

    Root keeps its rights; everybody else becomes root of a user namespace, if there may be one.
    """
    ways = (["unshare", "--net"], ["unshare", "--map-root-user", "--net"])
    return next((way for way in ways if _works([*way, "true"])), [])


def isolate() -> None:
    """Begin this very command anew in a network of its own, unless it is there; return where there is none to have."""
    if os.environ.get(INSIDE) or not (before := isolation()):
        return
    command = [*before, sys.executable, "-m", "vaoi_station", *sys.argv[1:]]
    kind = "user" if "--map-root-user" in before else "net"
    os.execvpe(command[0], command, os.environ | {INSIDE: kind})


def may_add() -> bool:
    """Whether this process may add addresses where it is."""
    return os.geteuid() == 0 and _works(["ip", "link", "set", "lo", "up"])


def entrance() -> list[str]:
    """What others write before a command so that it runs in our network; empty if it is everybody's."""
    kind = os.environ.get(INSIDE)
    if not kind:
        return []
    user = ["--user", "--preserve-credentials"] if kind == "user" else []
    return ["nsenter", "-t", str(os.getpid()), "--net", *user]


class Loopback:
    """A context manager: addresses on `lo`; those it has added it takes away again."""

    def __init__(self, wanted: Sequence[str]) -> None:
        self._wanted = tuple(wanted)
        self._added: list[str] = []

    def __enter__(self) -> Loopback:
        _ip("link", "set", "lo", "up")
        there = _ip("-oneline", "-4", "addr", "show", "dev", "lo").split()
        try:
            for address in self._wanted:
                if f"{address}/8" not in there:
                    _ip("addr", "add", f"{address}/8", "dev", "lo")
                    self._added.append(address)
        except DeviceError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        while self._added:
            _ip("addr", "del", f"{self._added.pop()}/8", "dev", "lo")


def _works(command: list[str]) -> bool:
    return (
        shutil.which(command[0]) is not None
        and subprocess.run(command, capture_output=True, check=False).returncode == 0
    )


def _ip(*words: str) -> str:
    if shutil.which("ip") is None:
        raise DeviceError("there is no command `ip`.", action="Install the distribution's package iproute2.")
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise DeviceError(
            f"`ip {' '.join(words)}` was refused: {done.stderr.strip()}.",
            action="Run it as root, or where users may have namespaces (sysctl kernel.unprivileged_userns_clone).",
        )
    return done.stdout
