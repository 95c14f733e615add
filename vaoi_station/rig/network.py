"""Addresses on loopback for the virtual cameras, in a network namespace if the kernel allows one.

GigE Vision uses one fixed UDP port (3956): two cameras need two addresses, and two rigs different ones or namespaces.
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
NAMESPACE_VARIABLE = "VAOI_RIG_NETWORK"
"""Environment variable set inside the rig's network namespace: `user` if it has a user namespace, else `net`."""


def addresses(count: int) -> tuple[str, ...]:
    """Return the loopback addresses of `count` cameras."""
    if not 1 <= count <= MAX_CAMERAS:
        raise InputError.field("vaoi rig", "--cameras", count, f"from 1 to {MAX_CAMERAS}")
    a, b, c, d = FIRST_ADDRESS
    return tuple(f"{a}.{b}.{c}.{d + k}" for k in range(count))


def isolation_command() -> list[str]:
    """Return the words that, put before a command, run it in a new network namespace; none if that is not possible.

    For root, only a network namespace is made. Any other user also becomes root of a new user namespace, if the kernel
    allows user namespaces.
    """
    ways = (["unshare", "--net"], ["unshare", "--map-root-user", "--net"])
    return next((way for way in ways if _works([*way, "true"])), [])


def enter_namespace() -> None:
    """Replace this process by the same command in a new network namespace.

    The function returns only if the process is already in the rig's namespace, or if the kernel allows no namespace.
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
    """Return the words that, put before a command, run it in the rig's namespace; none if the rig has no namespace."""
    kind = os.environ.get(NAMESPACE_VARIABLE)
    if not kind:
        return []
    # An ordinary user may enter the network namespace only together with the user namespace that owns it.
    user = ["--user", "--preserve-credentials"] if kind == "user" else []
    return ["nsenter", "-t", str(os.getpid()), "--net", *user]


class LoopbackAddresses:
    """Context manager that adds the missing addresses to the interface `lo`, and removes them at its end."""

    def __init__(self, wanted: Sequence[str]) -> None:
        self._wanted = tuple(wanted)
        self._added: list[str] = []

    def __enter__(self) -> LoopbackAddresses:
        _ip("link", "set", "lo", "up")
        # An address that exists already was added by another program or a person: it is used, but not removed.
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
