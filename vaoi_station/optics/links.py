"""How long the links need for the frames of one row: the slowest of camera, shared links and port of the computer.

All cameras expose at once and send at once. A link that several of them share carries one packet of each in turn; a
camera that is slower than its share of the links makes the row as long as itself.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

GVSP_OVERHEAD = 36
"""Bytes of the IP (20), UDP (8) and GVSP (8) headers of a packet. The packet size of a camera includes them."""
ETHERNET_OVERHEAD = 38
"""Bytes that Ethernet adds to each packet on the wire: preamble 8, header 14, checksum 4, gap 12."""
LARGEST_PACKET = 9000
"""Largest packet size in bytes: that of an Ethernet jumbo frame. Only loopback would take larger packets."""
USB_PAYLOAD = 0.64
"""Share of a USB3 link's nominal speed that is left for pixels: 80% after its coding (8b/10b), 80% of that in use."""
ITSELF = "the cameras themselves"
"""What limits a row if no shared link does."""


@dataclass(frozen=True)
class Link:
    """A link that cameras share: the uplink of a switch, a network port, a USB host controller."""

    name: str
    mbit_s: float | None
    """None if its speed is not known; it then limits nothing."""


@dataclass(frozen=True)
class Sender:
    """What one camera sends for a row, and over which links."""

    frame_bytes: int
    path: tuple[Link, ...]
    """The shared links between camera and memory."""
    own_mbit_s: float | None = None
    """What the camera can send: the speed of its own link or, if it is lower, the limit that it keeps."""
    packet_bytes: int | None = LARGEST_PACKET
    """Size of its packets with headers; None for USB, whose frames are counted without packets."""

    @property
    def packets(self) -> int:
        """Number of packets with pixels in a frame. Leader and trailer packets are small and not counted."""
        if self.packet_bytes is None:
            return 1
        return math.ceil(self.frame_bytes / (self.packet_bytes - GVSP_OVERHEAD))

    @property
    def wire_bytes(self) -> int:
        """Bytes of one packet on the wire."""
        return self.frame_bytes if self.packet_bytes is None else self.packet_bytes + ETHERNET_OVERHEAD

    def seconds(self, mbit_s: float | None) -> float:
        """Return the time of one packet at a speed; 0 if it is not known."""
        return self.wire_bytes * 8e-6 / mbit_s if mbit_s else 0.0


@dataclass(frozen=True)
class Share:
    """What a camera gets of the links that it shares."""

    packet_s: float
    """Time from the start of a packet to that of the next; 0 if no speed is known."""
    delay_s: float
    """Pause after each packet that leaves the other cameras their turn."""
    row_s: float
    """Time in which it sends a frame."""
    mbit_s: float | None
    """Its rate on the wire; None if nothing limits it."""
    slowest: str
    """Name of the link that limits it, or `ITSELF`."""


def share_links(senders: Sequence[Sender]) -> tuple[Share, ...]:
    """Return the share of every camera, in the order given. Links of one name are one, as fast as its lowest speed."""
    speeds: dict[str, float] = {}
    for sender in senders:
        for link in sender.path:
            if link.mbit_s is not None:
                speeds[link.name] = min(link.mbit_s, speeds.get(link.name, link.mbit_s))
    turn_s: defaultdict[str, float] = defaultdict(float)
    for sender in senders:
        for link in sender.path:
            turn_s[link.name] += sender.seconds(speeds.get(link.name))
    return tuple(_share(sender, speeds, turn_s) for sender in senders)


def slowest_row(senders: Sequence[Sender]) -> Share:
    """Return the share of the camera that needs longest for its frame: its `row_s` is the time of a row."""
    return max(share_links(senders), key=lambda share: share.row_s)


def _share(sender: Sender, speeds: Mapping[str, float], turn_s: Mapping[str, float]) -> Share:
    own_s = sender.seconds(sender.own_mbit_s)
    packet_s, slowest = own_s, ITSELF
    for link in sender.path:
        if turn_s[link.name] > packet_s:
            packet_s, slowest = turn_s[link.name], link.name
    # A camera that does not state its speed sends as fast as the link before it takes its packets.
    known = (sender.seconds(speeds.get(link.name)) for link in sender.path)
    sending_s = own_s or next((seconds for seconds in known if seconds), 0.0)
    rate = sender.wire_bytes * 8e-6 / packet_s if packet_s else None
    return Share(packet_s, max(packet_s - sending_s, 0.0), packet_s * sender.packets, rate, slowest)
