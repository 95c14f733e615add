"""The connections to the neighbours: one thread with an event loop, beside the line and never in its way.

The station connects to the machine upstream and listens for the next one; a second machine on the same lane gets
a notification that the lane is taken. What a neighbour sends is cut into messages, checked by its session, and acted
on by the lane.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, suppress
from datetime import datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict

from vaoi_station.config import StationConfig
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.hermes import supervisory
from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.lane import Inside, Lane, LineOrders, Side
from vaoi_station.hermes.listening import Listening
from vaoi_station.hermes.messages import Message, ProtocolError, read_message
from vaoi_station.hermes.session import (
    ERROR,
    FATAL,
    HANDSHAKE_S,
    INFORMATION,
    PROTOCOL_ERROR,
    REFUSED,
    SHUTDOWN,
    Answer,
    Role,
    Session,
    notification,
)
from vaoi_station.line_config import Hermes
from vaoi_station.model import Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import ContactsStatus
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

TICK_S = 0.1
"""Period at which runs, times and the state of the line are read."""
RETRY_S, CONNECT_S = 2.0, 5.0
"""Pause between two attempts to reach the machine upstream, and longest time of one."""
LOST_S = 15.0
"""Time without a neighbour after which a warning says so: machines are switched on one after the other."""
MOST_UNSENT = 1 << 20
"""Bytes that wait for a neighbour that does not read; beyond it the connection is ended."""
YIELD_S = 0.05
"""Time that a connection has to leave the lane to the next one, s."""
MOST_MESSAGES, MOST_SUPERVISORS = 500, 4
"""Messages of a neighbour within one tick, beyond which it is refused; supervisory systems at a time."""
KEPT_MESSAGES = 40
"""Number of the latest messages that the page shows."""
STOP_S, REFUSED_S = 3.0, 1.0
"""Longest wait for the end of the thread, and for a refused neighbour to end the connection, s."""
_PIECE, _SHOWN = 65_536, 600
"""Bytes that are read at once; characters of a message that are shown."""
_RESET = struct.pack("ii", 1, 0)
"""Option of a socket whose end resets the connection."""
TAP_SOCKET, FILE = "hermes-tap.sock", "hermes.json"
FORMAT, VERSION = "vaoi-hermes", 1
_AGAIN = "It connects again by itself; tell the maker of that machine if it repeats."
_ENDED = frozenset({"ready", "degraded", "failed"})
"""States of a run that has ended, in which its matrices are safe."""


class LineMessage(BaseModel):
    """One message that came from a neighbour or went to it."""

    model_config = ConfigDict(frozen=True)

    time: str
    side: Literal["upstream", "downstream", "supervisor"]
    sent: bool
    """Whether the station sent it."""
    text: str
    fault: str = ""
    """What was wrong with it, or why the connection ended after it."""


class Neighbour(BaseModel):
    """A machine beside the station, and the state of the transfer with it."""

    model_config = ConfigDict(frozen=True)

    side: Literal["upstream", "downstream", "supervisor"]
    address: str
    connected: bool
    machine: str = ""
    version: str = ""
    state: str = ""
    """State of the transfer, as in docs/line.md."""
    board_id: str | None = None
    """The board that is available or moves."""
    clock_off_s: float | None = None
    """How far its clock was ahead of this machine's in its last message; no decision uses it."""


class BoardInside(BaseModel):
    """A board between the barrier and the next machine."""

    model_config = ConfigDict(frozen=True)

    board_id: str
    run: str | None = None
    announced: bool = True
    """Whether the line said who it is; else the station made its id."""
    doubtful: bool = False
    """Whether it is not known if the next machine has it."""
    values: dict[str, str] = {}
    parts: dict[str, list[tuple[str, dict[str, str]]]] = {}


class LineStatus(BaseModel):
    """The neighbours of the station, the boards on their way through it, and the last messages."""

    model_config = ConfigDict(frozen=True)

    lane: int
    role: Literal["inline", "tap", "none", "contacts"]
    """`contacts`: station.toml has no table [hermes], but [smema]; `none`: neither."""
    neighbours: tuple[Neighbour, ...]
    boards: tuple[BoardInside, ...]
    """The boards that wait for the next machine, the first one first."""
    held: tuple[Reason, ...]
    """Why the machine upstream is not asked for the next board."""
    messages: tuple[LineMessage, ...]
    """The latest messages, newest last."""
    contacts: ContactsStatus | None = None
    """The neighbours by the contacts of IPC-SMEMA-9851; None without a table [smema]."""


NO_LINE = LineStatus(lane=0, role="none", neighbours=(), boards=(), held=(), messages=())
"""What is shown of a station whose neighbours do not speak Hermes."""


class _Waiting(BaseModel):
    """The file of the boards that wait for the next machine."""

    format: str = FORMAT
    version: int = VERSION
    boards: tuple[BoardInside, ...] = ()


class _Link:
    """A connection to a neighbour."""

    def __init__(self, side: Side, session: Session, writer: asyncio.StreamWriter) -> None:
        self.side, self.session, self.writer = side, session, writer
        self.framing = Framing()
        self.address = _peer(writer)
        self.end = ""
        """Why the station ends the connection; empty while it does not."""
        self.clock_off_s: float | None = None
        self.taken = 0
        """Number of messages since the latest tick."""
        _tune(writer)


class HermesService:
    """Talks to the neighbours of a station while it runs. Public methods may be called from any thread."""

    _lane: Lane
    _listening: Listening
    _orders: LineOrders

    def __init__(self, config: Hermes, station: StationConfig, events: EventLog) -> None:
        """Prepare the connections; `config` is the table [hermes]."""
        self._config, self._station, self._events = config, station, events
        self._machine = config.machine or station.name
        self._file, self._socket = station.data / FILE, station.data / TAP_SOCKET
        self._links: dict[Side, _Link] = {}
        self._supervisors: set[asyncio.StreamWriter] = set()
        self._open: dict[asyncio.Task[None] | None, asyncio.StreamWriter] = {}
        """The connections by the tasks that serve them."""
        self._messages: deque[LineMessage] = deque(maxlen=KEPT_MESSAGES)
        self._faults: dict[str, str] = {}
        self._lost_s: dict[Side, float] = {}
        self._said_s: dict[str, float] = {}
        self._refusal = ""
        self._last_event = events.last
        self._stopping = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._saved: tuple[tuple[Inside, ...], tuple[str, ...], bool] = ((), (), False)
        """The state of the lane when its boards were kept last."""
        self._saving: asyncio.Task[None] | None = None
        self.thread = SupervisedThread(lambda: asyncio.run(self._main()), "hermes", urgent=True)

    @classmethod
    def of(cls, station: StationConfig, events: EventLog) -> HermesService | None:
        """Return the connections of a station; None if its neighbours do not speak Hermes."""
        return None if station.hermes is None else cls(station.hermes, station, events)

    def running(self, watch: Callable[[SupervisedThread], object], orders: LineOrders) -> AbstractContextManager[None]:
        """Talk to the neighbours during a `with` block; `watch` supervises the thread."""
        line, self._orders = self._station.line, orders
        speed_mm_s = line.speed_mm_s if line.speed_limits_mm_s is None else None
        transfer_s, acts = self._config.longest_transfer_s(line), (self._send, self._publish, self._supervise)
        self._lane = Lane(self._config, self._machine, speed_mm_s, orders, *acts, transfer_s)
        self._listening = Listening(self._config, orders, self._note, self._publish)
        return self.thread.serving(watch, self._stopping.set, STOP_S)

    def reasons(self) -> tuple[Reason, ...]:
        """Return warnings: lost neighbours, addresses that cannot be used, a board between machines, no free place."""
        if self._loop is None:
            return ()  # it is not running yet
        now_s = time.monotonic()
        action = "Check machine, cable and the address in [hermes] (docs/line.md); it is tried again by itself."
        lost = (
            Reason(code="neighbour-lost", message=f"The {side} machine is not connected.", action=action)
            for side, since_s in sorted(self._lost_s.copy().items())
            if now_s - since_s > LOST_S
        )
        bad = (Reason(code="line-address", message=text, action=action) for text in self._faults.copy().values())
        return (*lost, *bad, *(self._lane.doubt() or self._lane.full()))

    def status(self) -> LineStatus:
        """Return neighbours, boards and the last messages."""
        config, links = self._config, self._links.copy()
        sides: tuple[tuple[Side, str | None], ...] = (("upstream", config.upstream), ("downstream", config.listen))
        neighbours = [_neighbour(side, _text(config.address(at)), links.get(side)) for side, at in sides if at]
        if config.supervisor is not None:
            at, there = config.supervisor, bool(self._supervisors)
            neighbours.append(Neighbour(side="supervisor", address=at, connected=there))
        if config.tap:
            neighbours += [Neighbour(side=side, address="", connected=True, machine=name)
                           for side, name in self._listening.machines.copy().items()]  # fmt: skip
        return LineStatus(
            lane=config.lane,
            role="tap" if config.tap else "inline",
            neighbours=tuple(neighbours),
            boards=tuple(map(_shown, tuple(self._lane.waiting))),
            held=() if config.tap else self._lane.held,
            messages=tuple(self._messages.copy()),
        )

    def remove(self, board_id: str) -> LineStatus:
        """Take that a board was taken out behind the cameras; `StateError` if it is not there, or is leaving."""
        loop = self._loop
        if loop is None or self._stopping.is_set():
            raise StateError("The connections to the neighbours are not running.", action="Wait a moment.")

        async def removed() -> bool:
            return self._lane.remove(board_id, time.monotonic())

        if not asyncio.run_coroutine_threadsafe(removed(), loop).result(STOP_S):
            message = f"Board {board_id!r} does not wait for the next machine, or is on its way to it."
            raise StateError(message, action="Read the boards with GET neighbours.")
        return self.status()

    # --- the thread

    async def _main(self) -> None:
        config, self._loop = self._config, asyncio.get_running_loop()
        self._load()
        if config.upstream is not None or config.tap:
            self._guarded(self._orders.by_messages, True)
        begun = time.monotonic()
        tasks = []
        if config.upstream is not None:
            self._lost_s["upstream"] = begun
            tasks.append(self._connect(config.address(config.upstream)))
        if config.listen is not None:
            self._lost_s["downstream"] = begun
            tasks.append(self._serve(config.address(config.listen), self._downstream))
        if config.supervisor is not None:
            tasks.append(self._serve(config.address(config.supervisor), self._supervised))
        if config.tap:
            tasks.append(self._read_along())
        running = [asyncio.create_task(task) for task in tasks]
        while not self._stopping.is_set():
            self.thread.beat()
            self._tick()
            await asyncio.sleep(TICK_S)
            for task in running:
                if task.done():
                    task.result()  # a fault of this program ends the thread, which the supervisor reports
        await self._end(running)

    async def _end(self, running: list[asyncio.Task[None]]) -> None:
        """Say that the station stops, end what runs, and keep what is known then."""
        for link in self._links.values():
            self._write(link, notification(SHUTDOWN, INFORMATION, "the station is stopping"))
        for writer in self._open.values():
            writer.close()
        if serving := [task for task in self._open if task is not None and task not in running]:
            await asyncio.wait(serving, timeout=STOP_S / 2)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
        self._tick()  # runs that have ended, and boards that came into doubt meanwhile
        while self._saving is not None:
            await asyncio.wait([self._saving])
            self._save()

    def _tick(self) -> None:
        now_s = time.monotonic()
        for link in tuple(self._links.values()):
            link.taken = 0
            self._apply(link, link.session.tick(now_s))
            if link.end:
                link.writer.close()  # ends the read that waits
        for record in self._events.read(self._last_event, 0.0, 200):
            self._last_event = record.number
            if record.kind == "run" and record.run is not None and record.state == "filming":
                self._guarded(self._lane.run_began, record.run, now_s)
            elif record.kind == "run" and record.run in self._lane.passing and record.state in _ENDED:
                self._guarded(self._lane.run_ended, record.run, now_s)
            elif record.kind == "board-missed":
                self._guarded(self._lane.run_ended, None, now_s, record.run)
        self._guarded(self._lane.decide, now_s)
        self._save()

    def _guarded(self, act: Callable[..., object], *args: object) -> None:
        """Let the lane act. What the queue of orders refuses is published, and a fault is logged: the line goes on."""
        try:
            act(*args)
        except Exception as error:  # noqa: BLE001  a fault here must not end the station
            # Every tick tries again: what lasts is published once.
            if str(error) == self._refusal or self._stopping.is_set():
                return
            self._refusal = str(error)
            if isinstance(error, VaoiError):
                self._publish("trouble", error.message, code=error.code, action=error.action)
            else:
                _log.exception("the neighbours are served on after a fault")

    # --- neighbours

    async def _connect(self, address: tuple[str, int]) -> None:
        """Keep a connection to the machine upstream."""
        while True:
            try:
                async with asyncio.timeout(CONNECT_S):
                    reader, writer = await asyncio.open_connection(*address)
            except OSError as error:
                _log.debug("%s is not reached: %s", _text(address), error)
            else:
                await self._talk("upstream", "receiver", reader, writer)
            await asyncio.sleep(RETRY_S)

    async def _serve(
        self,
        address: tuple[str, int],
        talk: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
    ) -> None:
        """Keep listening at an address."""
        while True:
            try:
                server = await asyncio.start_server(talk, *address)
            except OSError as error:
                self._faults[_text(address)] = f"{_text(address)} cannot be used: {error.strerror or error}."
                await asyncio.sleep(RETRY_S)
                continue
            self._faults.pop(_text(address), None)
            async with server:
                await server.serve_forever()

    async def _downstream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # The end of the connection before may be noticed after the beginning of this one.
        begun_s = time.monotonic()
        while "downstream" in self._links and time.monotonic() - begun_s < YIELD_S:
            await asyncio.sleep(YIELD_S / 10)
        if "downstream" in self._links:
            self._refuse("downstream", "the lane is taken by another connection", writer)
            await _closed(writer)
            return
        await self._talk("downstream", "sender", reader, writer)

    def _refuse(self, side: str, text: str, writer: asyncio.StreamWriter) -> None:
        """Tell a machine that there is no room for its connection."""
        said = notification(REFUSED, ERROR, text)
        self._note(side, said, sent=True, fault=f"from {_peer(writer)}")
        writer.write(said.to_bytes())

    async def _talk(self, side: Side, role: Role, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until either side ends it."""
        session = Session(role, self._machine, self._config.lane, time.monotonic())
        link = self._links[side] = _Link(side, session, writer)
        self._open[asyncio.current_task()] = writer
        if role == "receiver":
            self._write(link, session.hello())
        why = "the connection was closed"
        try:
            while not link.end and (data := await reader.read(_PIECE)):
                self._take(link, data)
        except OSError as error:
            why = error.strerror or type(error).__name__
        except Exception:  # noqa: BLE001  a fault here must not end the station: the neighbour connects again
            why = "a fault of this program"
            _log.exception("the connection to the %s machine is ended after a fault", side)
        finally:
            del self._links[side]
            self._lost_s[side] = time.monotonic()
            self._guarded(self._lane.lost, side, link.end or why, time.monotonic())
            if link.end:
                await _refused(reader, writer)
            await _closed(writer)
            self._open.pop(asyncio.current_task(), None)

    def _take(self, link: _Link, data: bytes) -> None:
        """Act on bytes of a neighbour."""
        try:
            for raw in link.framing.feed(data):
                message = read_message(raw)
                if message is None:
                    self._note(link.side, Message("unknown message"), fault="ignored")
                    continue
                link.taken += 1
                if link.taken > MOST_MESSAGES:
                    raise ProtocolError(f"more than {MOST_MESSAGES} messages came within {TICK_S:g} s")
                link.clock_off_s = _clock_off_s(message.timestamp)
                answer = link.session.received(message, time.monotonic())
                self._note(link.side, message, fault=answer.close or "; ".join(message.left_out))
                self._apply(link, answer)
                if link.end:
                    return
        except ProtocolError as error:
            self._note(link.side, Message("no message"), fault=str(error))
            self._apply(link, link.session.refuse(str(error)))

    def _apply(self, link: _Link, answer: Answer) -> None:
        for message in answer.send:
            self._write(link, message)
        if answer.close:
            link.end = answer.close
            text = f"The connection to the {link.side} machine {link.address} was ended: {answer.close}."
            self._publish("trouble", text, code="neighbour-refused", action=_AGAIN)
        elif answer.news is not None and answer.news.tag == "ServiceDescription":
            self._lost_s.pop(link.side, None)
            name = answer.news.get("MachineId")
            self._publish("line", f"The {link.side} machine {name!r} is connected.", code="neighbour-connected")
            self._guarded(self._lane.connected, link.side, link.session, time.monotonic())
        elif answer.news is not None:
            self._guarded(self._lane.received, link.side, answer.news, time.monotonic())

    def _send(self, side: Side, message: Message) -> None:
        """Send a message of the lane."""
        if (link := self._links.get(side)) is not None and not link.end:
            self._write(link, link.session.sent(message))

    def _write(self, link: _Link, message: Message) -> None:
        self._note(link.side, message, sent=True)
        link.writer.write(message.to_bytes())
        if link.writer.transport.get_write_buffer_size() > MOST_UNSENT:
            link.end = "it does not read what it is sent"
            link.writer.transport.abort()

    # --- supervisory system and tap

    async def _supervised(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a supervisory system until either side ends the connection."""
        # One that has not said who it is counts as well, as do the neighbours.
        if len(self._open) >= MOST_SUPERVISORS + 2:
            self._refuse("supervisor", f"{MOST_SUPERVISORS} systems are connected", writer)
            await _closed(writer)
            return
        _tune(writer)
        self._open[asyncio.current_task()] = writer
        framing = Framing()
        try:
            async with asyncio.timeout(HANDSHAKE_S) as first:
                while data := await reader.read(_PIECE):
                    for raw in framing.feed(data):
                        if (message := read_message(raw)) is None:
                            continue
                        first.reschedule(None)
                        self._note("supervisor", message)
                        if message.tag == "SupervisoryServiceDescription":
                            self._supervisors.add(writer)
                        if (reply := supervisory.answer(message, self._machine, self._config)) is not None:
                            self._note("supervisor", reply, sent=True)
                            writer.write(reply.to_bytes())
                    await writer.drain()
        except ProtocolError as error:
            self._note("supervisor", Message("no message"), fault=str(error))
            text = f"The connection of the supervisory system {_peer(writer)} was ended: {error}."
            self._publish("trouble", text, code="neighbour-refused", action=_AGAIN)
            writer.write(notification(PROTOCOL_ERROR, FATAL, str(error)).to_bytes())
        except OSError:
            pass  # it is gone, or has sent no message
        finally:
            self._supervisors.discard(writer)
            await _closed(writer)
            self._open.pop(asyncio.current_task(), None)

    def _supervise(self, message: Message) -> None:
        """Send what arrived or departed to all supervisory systems."""
        for writer in self._supervisors:
            if writer.transport.get_write_buffer_size() > MOST_UNSENT:
                writer.transport.abort()
            else:
                writer.write(message.to_bytes())
        if self._supervisors:
            self._note("supervisor", message, sent=True)

    async def _read_along(self) -> None:
        """Take the copies that the tap sends."""
        self._socket.unlink(missing_ok=True)
        listening = self._listening

        class Copies(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, _addr: object) -> None:
                guarded(listening.take, data)

        guarded, loop = self._guarded, asyncio.get_running_loop()
        copies = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        copies.setblocking(False)
        try:
            copies.bind(str(self._socket))
        except OSError as error:  # its path may be longer than the kernel allows
            self._faults["tap"] = f"{self._socket} cannot be used: {error.strerror or error}."
            copies.close()
            return
        transport, _ = await loop.create_datagram_endpoint(Copies, sock=copies)
        try:
            await loop.create_future()
        finally:
            transport.close()
            self._socket.unlink(missing_ok=True)

    # --- what is shown and kept

    def _note(self, side: str, message: Message, *, sent: bool = False, fault: str = "") -> None:
        text = str(message)[:_SHOWN]
        line = LineMessage.model_validate({"time": utc(), "side": side, "sent": sent, "text": text, "fault": fault})
        self._messages.append(line)

    def _publish(self, kind: str, message: str, *, code: str, action: str = "") -> None:
        if code.startswith("neighbour-"):
            # A neighbour that repeats itself must not fill the log.
            now_s, who = time.monotonic(), f"{code} {message[:20]}"
            if now_s - self._said_s.get(who, 0.0) < 1.0:
                return
            self._said_s[who] = now_s
        self._events.add(kind, message, code=code, action=action)

    def _load(self) -> None:
        """Read the boards that waited when the station ended: they stand behind the cameras still."""
        if not self._file.exists():
            return
        try:
            data = read_json(self._file)
            check_format(data, self._file, FORMAT, VERSION)
            kept = parse(_Waiting, data, self._file).boards
        except VaoiError as error:
            _log.warning("%s The boards that waited for the next machine are forgotten.", error)
            return
        self._lane.waiting.extend(
            Inside(b.board_id, b.values, {n: tuple(e) for n, e in b.parts.items()}, b.run, b.announced, b.doubtful)
            for b in kept
        )

    def _save(self) -> None:
        """Keep the boards, if they have changed. Another thread waits for the disk, and neighbours for neither."""
        if self._saving is not None:
            if not self._saving.done():
                return
            self._saving = None
        lane = self._lane
        state = tuple(lane.waiting), tuple(lane.passing), lane.leaving
        if state != self._saved:
            now, self._saved = lane.to_keep(), state
            self._saving = asyncio.create_task(asyncio.to_thread(self._write_boards, now))

    def _write_boards(self, now: tuple[Inside, ...]) -> None:
        try:
            write_json(self._file, _Waiting(boards=tuple(map(_shown, now))).model_dump(mode="json"))
        except VaoiError as error:
            _log.warning("%s After a restart these boards are not known.", error)


def _shown(board: Inside) -> BoardInside:
    parts = {name: [(tag, dict(values)) for tag, values in entries] for name, entries in board.parts.items()}
    return BoardInside(
        board_id=board.board_id,
        run=board.run,
        announced=board.announced,
        doubtful=board.doubtful,
        values=dict(board.values),
        parts=parts,
    )


def _neighbour(side: Side, address: str, link: _Link | None) -> Neighbour:
    if link is None:
        return Neighbour(side=side, address=address, connected=False)
    session = link.session
    peer = session.peer or Message("")
    return Neighbour(
        side=side,
        address=link.address,
        connected=session.peer is not None,
        machine=peer.get("MachineId") or "",
        version=peer.get("Version") or "",
        state=session.state,
        board_id=session.board,
        clock_off_s=link.clock_off_s,
    )


def _clock_off_s(stamp: str) -> float | None:
    """Return how far the clock of a time stamp is ahead, s; None if it is no time. Without a zone it is local time."""
    try:
        return round(datetime.fromisoformat(stamp).astimezone().timestamp() - time.time(), 1)
    except (ValueError, OverflowError, OSError):
        return None


def _text(address: tuple[str, int]) -> str:
    return f"{address[0]}:{address[1]}"


def _peer(writer: asyncio.StreamWriter) -> str:
    return "{}:{}".format(*(writer.get_extra_info("peername") or ("?", 0))[:2])


def _tune(writer: asyncio.StreamWriter) -> None:
    """Notice a neighbour that was switched off or unplugged, whose end comes without a word."""
    raw = writer.get_extra_info("socket")
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 10)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 5)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 20_000)


async def _refused(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Let a neighbour read why it is refused and end the connection; reset it if it sends more instead."""
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(REFUSED_S):
            if await reader.read(_PIECE):
                writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                writer.transport.abort()


async def _closed(writer: asyncio.StreamWriter) -> None:
    """Close a connection after what was written has gone out."""
    writer.close()
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(STOP_S):
            await writer.wait_closed()
