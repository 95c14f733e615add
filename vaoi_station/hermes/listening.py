"""Reads along between two machines by the copies of the tap: the same announcements, without a say of the station."""

from __future__ import annotations

from collections.abc import Callable

from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.lane import TRANSFERS, LineOrders, Side, announce
from vaoi_station.hermes.messages import Message, ProtocolError, read_message
from vaoi_station.hermes.tap import ENDED, FROM_SENDER, HEAD
from vaoi_station.line_config import Hermes


class Listening:
    """Tells the queue of orders what passes between the neighbours."""

    def __init__(
        self, config: Hermes, orders: LineOrders, note: Callable[..., object], publish: Callable[..., object]
    ) -> None:
        """Prepare; `note` shows a message of a side with its fault, `publish` is like `EventLog.add`."""
        self._config, self._orders, self._note, self._publish = config, orders, note, publish
        self._number: int | None = None
        self._framings: dict[Side, Framing] = {}
        self.machines: dict[Side, str] = {}
        """Names of the neighbours of the connection under way."""
        self._offered = self._moving = False

    def take(self, datagram: bytes) -> None:
        """Take one copy of the tap."""
        if len(datagram) < HEAD.size:
            return
        what, number = HEAD.unpack_from(datagram)
        if number != self._number or what == ENDED:
            self._end()
            self._number = None if what == ENDED else number
        if what != ENDED:
            self._read("upstream" if what == FROM_SENDER else "downstream", datagram[HEAD.size :])

    def _end(self) -> None:
        if self._moving:
            self._orders.finished(self._config.lane, "incomplete")
        elif self._offered:
            self._orders.withdrawn(self._config.lane)
        self._offered = self._moving = False
        self._framings.clear()
        self.machines.clear()

    def _read(self, side: Side, data: bytes) -> None:
        try:
            for raw in self._framings.setdefault(side, Framing()).feed(data):
                if (message := read_message(raw)) is not None:
                    self._note(side, message)
                    self._act(side, message)
        except ProtocolError as error:
            # A copy was lost, or the neighbours do not keep to the standard: the next messages are read again.
            self._framings.pop(side, None)
            self._note(side, Message("no message"), fault=str(error))

    def _act(self, side: Side, message: Message) -> None:
        lane = self._config.lane
        match message.tag:
            case "ServiceDescription":
                self.machines[side] = message.values["MachineId"]
            case "BoardAvailable" if not self._moving:
                self._offered = True
                announce(self._orders, self._config, message, self._publish)
            case "RevokeBoardAvailable" if self._offered and not self._moving:
                self._offered = False
                self._orders.withdrawn(lane)
            case "StartTransport" if self._offered:
                self._moving = True
                self._orders.started(lane)
            case "TransportFinished" if self._moving:
                self._offered = self._moving = False
                self._orders.finished(lane, TRANSFERS[message.values["TransferState"]])
