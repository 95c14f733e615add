"""A network share whose server can fail or hang: a FUSE file system in memory, served by a process of the test.

A program that waits for its server is blocked in the kernel and cannot be killed, as with a hard mount of NFS.
`python share.py DIRECTORY` mounts it in a mount namespace of its own and obeys lines on stdin.
"""

from __future__ import annotations

import ctypes
import errno
import os
import stat
import struct
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

CHANGING = frozenset({4, 9, 10, 11, 12, 16, 20, 30, 35, 45})
"""Requests that change files: SETATTR, MKDIR, UNLINK, RMDIR, RENAME, WRITE, FSYNC, FSYNCDIR, CREATE, RENAME2."""
_FORGETS = frozenset({2, 42})
_AFTERWARDS = _FORGETS | {18, 29}
"""Requests for which no program waits: FORGET, BATCH_FORGET, RELEASE, RELEASEDIR."""
_HEADER = struct.Struct("<IIQQIIII")


class Share:
    """The share, as a test sees it."""

    def __init__(self, directory: Path) -> None:
        """Mount it; OSError if this machine permits no mounts of FUSE."""
        directory.mkdir()
        command = [sys.executable, __file__, str(directory)]
        self._server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if self._line() != "mounted":
            self._server.communicate()
            raise OSError(errno.EPERM, "FUSE cannot be mounted here")
        self.directory = directory
        """Where programs that are started with `prefix` see it."""
        self.seen_from_here = Path(f"/proc/{self._server.pid}/root{directory}")
        """Where this process sees it; `Path.resolve` leads elsewhere."""
        self.prefix = ["nsenter", f"--target={self._server.pid}", "--mount", f"--wd={Path.cwd()}"]

    def order(self, order: str) -> None:
        """Have the server obey: `work`, `hang`, `refuse ERRNO` (of changes) or `fail ERRNO` (of everything).

        An order may begin with `after N `: it holds from the N-th written block on. `blocked` waits for a request that
        a hanging server does not answer.
        """
        assert self._server.stdin is not None
        self._server.stdin.write(f"{order}\n")
        self._server.stdin.flush()
        assert self._line() == "done"

    def close(self) -> None:
        """End the server: the kernel refuses all requests that wait."""
        self._server.communicate()

    def _line(self) -> str:
        assert self._server.stdout is not None
        return self._server.stdout.readline().strip()


@dataclass
class _Node:
    mode: int
    content: bytearray = field(default_factory=bytearray)
    names: dict[bytes, int] = field(default_factory=dict)
    changed_s: float = field(default_factory=time.time)


class _RefusedError(Exception):
    """A request that the server refuses with an error number."""


class _Server:
    """Serves the requests of the kernel, one after the other."""

    def __init__(self, device: int) -> None:
        self._device = device
        self._nodes = {1: _Node(stat.S_IFDIR | 0o755)}
        self._last = 1
        self.works = threading.Event()
        self.works.set()
        self.blocked = threading.Event()
        self.error, self.of_all = 0, False
        self._later: tuple[int, list[str]] | None = None

    def obey(self, words: list[str]) -> None:
        """Obey one order of the test."""
        if words[0] == "blocked":
            self.blocked.wait()
            return
        if words[0] == "after":
            self._later = (int(words[1]), words[2:])
            return
        self.error = 0 if words[0] in ("work", "hang") else int(words[1])
        self.of_all = words[0] == "fail"
        (self.works.clear if words[0] == "hang" else self.works.set)()

    def run(self) -> None:
        """Serve until the file system is unmounted."""
        while True:
            try:
                request = os.read(self._device, 1 << 18)
            except OSError as error:
                if error.errno == errno.ENOENT:
                    continue
                return
            _, opcode, unique, node, *_ = _HEADER.unpack_from(request)
            if opcode == 16 and self._later is not None:
                left, words = self._later
                self._later = (left - 1, words) if left else None
                if not left:
                    self.obey(words)
            if opcode not in _AFTERWARDS and not self.works.is_set():
                self.blocked.set()
                self.works.wait()
            if opcode in _FORGETS or opcode == 36:
                continue
            try:
                if self.error and opcode != 26 and (self.of_all or opcode in CHANGING):
                    raise _RefusedError(self.error)
                reply, refused = self._reply(opcode, node, request[40:]), 0
            except _RefusedError as error:
                reply, refused = b"", int(error.args[0])
            os.write(self._device, struct.pack("<IiQ", 16 + len(reply), -refused, unique) + reply)

    def _reply(self, opcode: int, number: int, body: bytes) -> bytes:  # noqa: PLR0911, PLR0912  one case per request
        if opcode == 26:
            return struct.pack("<IIIIHHII9I", 7, 31, 0, 0, 12, 9, 1 << 17, 1, *[0] * 9)
        node = self._nodes[number]
        if opcode == 1:
            return self._entry(self._child(node, body[:-1]))
        if opcode in (3, 4):
            if opcode == 4:
                self._set(node, body)
            return struct.pack("<QII", 0, 0, 0) + self._attributes(number)
        if opcode in (9, 35):
            mode, name = struct.unpack_from("<I", body, 0 if opcode == 9 else 4)[0], body[8 if opcode == 9 else 16 : -1]
            kind = stat.S_IFDIR if opcode == 9 else stat.S_IFREG
            self._last += 1
            self._nodes[self._last] = _Node(kind | stat.S_IMODE(mode))
            node.names[name] = self._last
            return self._entry(self._last) + (b"" if opcode == 9 else bytes(16))
        if opcode in (10, 11):
            if self._nodes[self._child(node, body[:-1])].names:
                raise _RefusedError(errno.ENOTEMPTY)
            del node.names[body[:-1]]
        elif opcode in (12, 45):
            (target,) = struct.unpack_from("<Q", body)
            old, new = body[8 if opcode == 12 else 16 : -1].split(b"\0")
            self._nodes[target].names[new] = self._child(node, old)
            del node.names[old]
        elif opcode in (14, 27):
            return bytes(16)
        elif opcode == 15:
            offset, size = struct.unpack_from("<QI", body, 8)
            return bytes(node.content[offset : offset + size])
        elif opcode == 16:
            offset, size = struct.unpack_from("<QI", body, 8)
            node.content[offset : offset + size] = body[40 : 40 + size]
            node.changed_s = time.time()
            return struct.pack("<II", size, 0)
        elif opcode == 17:
            return struct.pack("<5Q4I6I", 1 << 20, 1 << 19, 1 << 19, 1 << 20, 1 << 19, 4096, 255, 4096, 0, *[0] * 6)
        elif opcode == 28:
            return self._listed(node, *struct.unpack_from("<QI", body, 8))
        elif opcode not in (18, 20, 25, 29, 30):
            raise _RefusedError(errno.ENOSYS)
        return b""

    def _child(self, node: _Node, name: bytes) -> int:
        if name not in node.names:
            raise _RefusedError(errno.ENOENT)
        return node.names[name]

    def _set(self, node: _Node, body: bytes) -> None:
        (valid,), (size,), (mode,) = (struct.unpack_from(f, body, at) for f, at in (("<I", 0), ("<Q", 16), ("<I", 68)))
        if valid & 8:
            node.content[size:] = bytes(max(0, size - len(node.content)))
        if valid & 1:
            node.mode = stat.S_IFMT(node.mode) | stat.S_IMODE(mode)

    def _listed(self, node: _Node, offset: int, size: int) -> bytes:
        listed = b""
        for n, (name, number) in enumerate(list(node.names.items())[offset:], offset + 1):
            kind = stat.S_IFMT(self._nodes[number].mode) >> 12
            entry = struct.pack("<QQII", number, n, len(name), kind) + name
            entry += bytes(-len(entry) % 8)
            if len(listed) + len(entry) > size:
                break
            listed += entry
        return listed

    def _attributes(self, number: int) -> bytes:
        node = self._nodes[number]
        at_s, size = int(node.changed_s), len(node.content)
        return struct.pack(
            "<6Q10I", number, size, -(-size // 512), at_s, at_s, at_s, 0, 0, 0, node.mode, 1, os.geteuid(),
            os.getegid(), 0, 4096, 0,
        )  # fmt: skip

    def _entry(self, number: int) -> bytes:
        return struct.pack("<4Q2I", number, 0, 0, 0, 0, 0) + self._attributes(number)


def _mount(directory: str) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    new_namespace, private = 0x20000, 0x44000
    if libc.unshare(new_namespace) or libc.mount(None, b"/", None, ctypes.c_ulong(private), None):
        raise OSError(ctypes.get_errno(), "no mount namespace")
    device = os.open("/dev/fuse", os.O_RDWR)
    options = f"fd={device},rootmode=40000,user_id={os.geteuid()},group_id={os.getegid()}"
    if libc.mount(b"share", directory.encode(), b"fuse", ctypes.c_ulong(0), options.encode()):
        raise OSError(ctypes.get_errno(), "no mount of FUSE")
    return device


def main() -> None:
    """Serve until stdin ends."""
    try:
        server = _Server(_mount(sys.argv[1]))
    except OSError as error:
        print(error, flush=True)
        return
    threading.Thread(target=server.run, daemon=True).start()
    print("mounted", flush=True)
    for line in sys.stdin:
        server.obey(line.split())
        print("done", flush=True)
    os._exit(0)


if __name__ == "__main__":
    main()
