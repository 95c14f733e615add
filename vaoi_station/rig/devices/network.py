"""Give virtual cameras addresses on loopback, in a network namespace of their own where the kernel allows it.

GigE Vision has one fixed UDP port (3956). Two cameras therefore need two addresses, and two rigs need different
addresses or different namespaces. A namespace disappears with its last process, so nothing is left behind.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence

from vaoi_station.errors import DeviceError, InputError

FIRST_ADDRESS = (127, 0, 0, 2)
MAX_CAMERAS = 200
"""Largest number of cameras of one rig: the last byte of the address must stay below 255."""
NAMESPACE_VARIABLE = "VAOI_RIG_NETWORK"
"""Environment variable that is set inside the rig's namespace; `user` if a user namespace belongs to it."""


def addresses(count: int) -> tuple[str, ...]:
    """Return one address for each camera.

    Raises:
        InputError: `count` is not from 1 to MAX_CAMERAS.
    """
    if not 1 <= count <= MAX_CAMERAS:
        raise InputError.field("vaoi rig", "--cameras", count, f"from 1 to {MAX_CAMERAS}")
    a, b, c, d = FIRST_ADDRESS
    return tuple(f"{a}.{b}.{c}.{d + k}" for k in range(count))


def isolation_command() -> list[str]:
    """Return the words that start a command in a new network namespace; empty if the kernel allows none.

    Root keeps its rights. Any other user becomes root of a new user namespace, if user namespaces are enabled.
    """
    ways = (["unshare", "--net"], ["unshare", "--map-root-user", "--net"])
    return next((way for way in ways if _works([*way, "true"])), [])


def enter_namespace() -> None:
    """Replace this process by the same command in a new network namespace.

    Returns only if the process is in one already, or if the kernel allows none.
    """
    if os.environ.get(NAMESPACE_VARIABLE) or not (before := isolation_command()):
        return
    command = [*before, sys.executable, "-m", "vaoi_station", *sys.argv[1:]]
    kind = "user" if "--map-root-user" in before else "net"
    os.execvpe(command[0], command, os.environ | {NAMESPACE_VARIABLE: kind})


def may_add_addresses() -> bool:
    """Whether this process may add addresses to the loopback interface of its namespace."""
    return os.geteuid() == 0 and _works(["ip", "link", "set", "lo", "up"])


def entry_command() -> list[str]:
    """Return the words that start a command in the rig's namespace; empty if the rig uses the machine's own network."""
    kind = os.environ.get(NAMESPACE_VARIABLE)
    if not kind:
        return []
    # Without the user namespace that owns it, an ordinary user may not enter the network namespace.
    user = ["--user", "--preserve-credentials"] if kind == "user" else []
    return ["nsenter", "-t", str(os.getpid()), "--net", *user]


class LoopbackAddresses:
    """Addresses on `lo`, as a context manager; it removes those that it has added."""

    def __init__(self, wanted: Sequence[str]) -> None:
        self._wanted = tuple(wanted)
        self._added: list[str] = []

    def __enter__(self) -> LoopbackAddresses:
        _ip("link", "set", "lo", "up")
        # An address that exists already belongs to the machine's administrator: it is used, and not removed.
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
