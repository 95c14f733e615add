"""A relay between two machines of the line, with copies of what they say for the station that reads along.

`python -m vaoi_station.hermes.tap LISTEN TARGET SOCKET`: the machine that gets the boards connects to LISTEN instead of
its neighbour, TARGET is that neighbour, and SOCKET is `hermes-tap.sock` in the station's directory of data.

It fails open: every byte is passed on before it is copied, the copies are datagrams that are dropped while no station
takes them, and nothing is parsed. It imports the standard library only, so that it is there again in a moment.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import sys
from contextlib import suppress

CHUNK = 16_384
"""Bytes that are passed on at once; a datagram holds them."""
CONNECT_S = 5.0
HEAD = struct.Struct("!cI")
"""Head of a datagram: what it is, and the number of the connection."""
FROM_SENDER, FROM_RECEIVER, ENDED = b"S", b"R", b"E"
"""Bytes of the machine that has the boards; of the one that gets them; the end of a connection, without bytes."""


class Tap:
    """Relays the connections of one lane."""

    def __init__(self, target: tuple[str, int], station: str) -> None:
        """Prepare the relay to `target`; `station` is the socket of the station."""
        self._target, self._station, self._number = target, station, 0
        self._copies = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._copies.setblocking(False)

    async def relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Connect a machine that gets boards to the one that has them, until either ends the connection."""
        self._number = number = (self._number + 1) % (1 << 32)
        try:
            async with asyncio.timeout(CONNECT_S):
                from_sender, to_sender = await asyncio.open_connection(*self._target)
        except OSError:
            writer.close()  # it tries again, as if its neighbour was off
            return
        ways = {
            asyncio.create_task(self._pass(from_sender, writer, FROM_SENDER, number)),
            asyncio.create_task(self._pass(reader, to_sender, FROM_RECEIVER, number)),
        }
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            for end in (writer, to_sender):
                end.close()
            self._copy(ENDED, number, b"")

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, what: bytes, number: int) -> None:
        with suppress(OSError):
            while data := await reader.read(CHUNK):
                writer.write(data)
                await writer.drain()
                self._copy(what, number, data)

    def _copy(self, what: bytes, number: int, data: bytes) -> None:
        # The station may be off, or slower than the line: the line does not wait for it.
        with suppress(OSError):
            self._copies.sendto(HEAD.pack(what, number) + data, self._station)


async def serve(listen: tuple[str, int], target: tuple[str, int], station: str) -> None:
    """Relay until the process ends."""
    server = await asyncio.start_server(Tap(target, station).relay, *listen, limit=CHUNK)
    async with server:
        await server.serve_forever()


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise SystemExit(f"{text!r} is no address such as 192.168.1.10:50101")
    return host, int(port)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        raise SystemExit("usage: python -m vaoi_station.hermes.tap LISTEN TARGET SOCKET")
    with suppress(KeyboardInterrupt):
        asyncio.run(serve(_address(sys.argv[1]), _address(sys.argv[2]), sys.argv[3]))
