"""Is a GigE Vision camera there? One small question that anybody may ask, answered within milliseconds.

Aravis asks five times half a second before it gives a camera up, and holds the camera's lock meanwhile. So we ask for
the protocol version (bootstrap register 0) by a datagram of our own: GVCP's READREG needs no control of the camera.
"""

from __future__ import annotations

import socket
import struct
from itertools import count

from vaoi_station.acquisition.cameras.aravis.network import CONTROL_PORT

_KEY, _ACKNOWLEDGE, _READ_REGISTER, _READ_REGISTER_ANSWER = 0x42, 0x01, 0x0080, 0x0081
_VERSION_REGISTER = 0
_ids = count(1)


def question(request_id: int) -> bytes:
    """GVCP: READREG of the version register."""
    return struct.pack(">BBHHHI", _KEY, _ACKNOWLEDGE, _READ_REGISTER, 4, request_id, _VERSION_REGISTER)


def is_answer(datagram: bytes, request_id: int) -> bool:
    """Whether it acknowledges that question, be it by a refusal: who refuses is there."""
    if len(datagram) < 8:
        return False
    _, command, _, answered = struct.unpack(">HHHH", datagram[:8])
    return bool(command == _READ_REGISTER_ANSWER and answered == request_id)


def answers(address: str, timeout_s: float = 0.2, tries: int = 3) -> bool:
    """Ask a camera at an address; at most `tries` times `timeout_s`."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.settimeout(timeout_s)
        try:
            asker.connect((address, CONTROL_PORT))
        except OSError:
            return False
        return any(_ask(asker) for _ in range(tries))


def _ask(asker: socket.socket) -> bool:
    request_id = next(_ids) % 0xFFFF + 1
    try:
        asker.send(question(request_id))
        while not is_answer(asker.recv(1024), request_id):
            pass  # an answer to an earlier question
    except OSError:  # no answer in time, or nobody listens there
        return False
    return True
