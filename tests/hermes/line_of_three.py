"""A line of three machines in simulated time: `python -m tests.hermes.line_of_three --boards 1000 --seed 1`.

The station's own lane, sessions and queue of orders stand between two machines that revoke, time out, die and come back
at random, and people take boards off the belt and put others in. Boards come late or are missed, orders wait with and
without ids, and the station is killed and starts anew at once.
Every byte goes through framing, cut anywhere. The belt knows which board is which: at the next machine each has the id
of its own message, or one that the station made as it knew none.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import random
import time
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from tests.runs.run.test_order_queue import an_order
from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.lane import Lane, Side, Transfer
from vaoi_station.hermes.messages import Message, read_message
from vaoi_station.hermes.session import Answer, Role, Session, State
from vaoi_station.line_config import Hermes
from vaoi_station.model import Reason
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.order_queue import LATE_S, MOST_WAITING, LineBoard, OrderQueue, Queued
from vaoi_station.runs.run.orders import Orders

STATION, ARMED = "station", an_order()
STUCK_S = 2000.0
"""Time without a board that moves on after which the line counts as stuck."""
SHORTEST_S, LONGEST_S = 1.0, 6.0
"""Time from StartTransport until a board meets the barrier."""
FAILED = {"0": "unknown", "1": "good", "2": "bad"}


@dataclass(eq=False)
class Board:
    """A board on the belt."""

    number: int
    id: str
    failed: str
    where: str = "upstream"
    by_hand: bool = False


class World:
    """Simulated time."""

    def __init__(self, seed: int) -> None:
        self.now_s, self.random = 0.0, random.Random(seed)
        self._due: list[tuple[float, int, Callable[[], object]]] = []
        self._count = itertools.count()

    def number(self) -> int:
        return next(self._count)

    def after(self, delay_s: float, act: Callable[[], object]) -> None:
        heapq.heappush(self._due, (self.now_s + delay_s, next(self._count), act))

    def step(self) -> None:
        self.now_s, _, act = heapq.heappop(self._due)
        act()


class End:
    """One end of a connection: what a machine does with it."""

    session: Session | None = None
    send: Callable[[Message], None]

    def up(self) -> None: ...
    def take(self, message: Message) -> None: ...
    def down(self) -> None: ...


class Wire:
    """A connection that is made again after each break; messages need up to 50 ms and are cut anywhere."""

    def __init__(self, world: World, sender: End, receiver: End, decisions_s: list[float], station: Role) -> None:
        self.world, self.decisions_s, self.station = world, decisions_s, station
        self.ends: dict[Role, End] = {"sender": sender, "receiver": receiver}
        self.generation = 0
        for role in self.ends:
            self.ends[role].send = lambda message, role=role: self._send(role, self.generation, message)  # type: ignore[misc]
        self.connect()

    def connect(self) -> None:
        self.generation += 1
        self.open, self.quiet_until_s = True, dict.fromkeys(self.ends, 0.0)
        self.framings = {role: Framing() for role in self.ends}
        for role, end in self.ends.items():
            end.session = Session(role, STATION if role == self.station else "other", 1, self.world.now_s)
        receiver = self.ends["receiver"].session
        assert receiver is not None
        self._write("receiver", receiver.hello())
        self.world.after(self.world.random.uniform(50, 4000), lambda g=self.generation: self.cut(g))  # type: ignore[misc]

    def cut(self, generation: int) -> None:
        """Break the connection: what was on its way is lost, and each side notices it by itself."""
        if generation != self.generation or not self.open:
            return
        self.open = False
        late_s = [self.world.random.uniform(0, 0.5) for _ in self.ends]
        for wait_s, end in zip(late_s, self.ends.values(), strict=True):
            self.world.after(wait_s, end.down)
        self.world.after(max(late_s) + 2.0, self.connect)

    def _send(self, role: Role, generation: int, message: Message) -> None:
        session = self.ends[role].session
        assert session is not None
        if session.state is not State.CLOSED and generation == self.generation:
            self._write(role, session.sent(message))

    def _write(self, role: Role, message: Message) -> None:
        other: Role = "receiver" if role == "sender" else "sender"
        rng = self.world.random
        data = message.to_bytes()
        cut = rng.randrange(len(data))
        for piece in (data[:cut], data[cut:]):
            at_s = max(self.quiet_until_s[other], self.world.now_s + rng.uniform(0, 0.05))
            self.quiet_until_s[other] = at_s
            deliver = lambda piece=piece, g=self.generation: self._deliver(other, g, piece)  # noqa: E731
            self.world.after(at_s - self.world.now_s, deliver)

    def _deliver(self, role: Role, generation: int, data: bytes) -> None:
        if generation != self.generation or not self.open:
            return
        begun_s = time.perf_counter()
        for raw in self.framings[role].feed(data):
            message = read_message(raw)
            assert message is not None
            end = self.ends[role]
            assert end.session is not None
            self._apply(role, end, end.session.received(message, self.world.now_s))
        if role == self.station:
            self.decisions_s.append(time.perf_counter() - begun_s)

    def _apply(self, role: Role, end: End, answer: Answer) -> None:
        for message in answer.send:
            self._write(role, message)
        assert not answer.close, f"{role} refused at {self.world.now_s}: {answer.close}"
        if answer.news is not None and answer.news.tag == "ServiceDescription":
            end.up()
        elif answer.news is not None:
            end.take(answer.news)


class QueuedOrders:
    """The station's orders in simulated time: the line is armed with the type of all boards, and orders wait too."""

    def __init__(self, world: World, waiting: tuple[Queued, ...] = ()) -> None:
        self._world, self._orders = world, Orders(queue=OrderQueue((SHORTEST_S, LONGEST_S)))
        self._taken: dict[str, tuple[Order | None, float, float]] = {}
        """The order of each run, since when it was known, and the time at the barrier."""
        self.queue = self._orders.queue
        self.queue.resume(waiting, world.now_s)
        self._orders.accept(ARMED, None, world.now_s)
        self._orders.doubt(world.now_s, world.now_s, "the station was started")

    def post(self, name: str | None) -> None:
        if len(self.queue.waiting) < MOST_WAITING:
            number = f"o{self._world.number()}"
            self.queue.add(Queued(number, replace(ARMED, board_id=name, job_id=name)), self._world.now_s)

    def by_messages(self, on: bool) -> None:
        self.queue.listen(on, self._world.now_s)

    def announce(self, lane: int, board: LineBoard) -> tuple[Reason, ...]:
        self.queue.announce(lane, board, ARMED if self._world.random.random() < 0.7 else None, self._world.now_s)
        return self.may_accept(lane)

    def withdrawn(self, lane: int) -> tuple[Reason, ...]:
        self.queue.withdrawn(lane)
        return self.may_accept(lane)

    def started(self, lane: int) -> tuple[Reason, ...]:
        self.queue.started(lane, self._world.now_s)
        return self.may_accept(lane)

    def finished(self, lane: int, state: Transfer) -> tuple[Reason, ...]:
        self.queue.finished(lane, state, self._world.now_s)
        return self.may_accept(lane)

    def may_accept(self, lane: int) -> tuple[Reason, ...]:
        self.queue.expire(self._world.now_s)
        return self.queue.refusals(lane, ARMED)

    def barrier(self, run: str) -> None:
        order = self._orders.take(self._world.now_s, run, ARMED)
        self._taken[run] = order, self._orders.taken_since_s, self._world.now_s

    def missed(self) -> None:
        self.queue.missed(self._world.now_s, self._world.now_s)
        self._orders.doubt(self._world.now_s, self._world.now_s, "a board passed without a run")

    def of_run(self, run: str) -> Order | None:
        """Return the order of a run; None if it is not certain."""
        order, since_s, edge_s = self._taken[run]
        if self._orders.doubt_of(since_s, edge_s) is None:
            return order
        self.queue.disown(run)
        return None

    def board_of_run(self, run: str) -> LineBoard | None:
        return self.queue.board_of_run(run) if run in self._taken and self.of_run(run) is not None else None

    def came_failed(self, run: str) -> bool:
        board = self.queue.board_of_run(run)
        return board is not None and board.failed == "bad"


class Upstream(End):
    """Has the boards; revokes, finishes late or not at all."""

    def __init__(self, world: World, line: Line) -> None:
        self.world, self.line, self.generation = world, line, 0
        self.board: Board | None = None

    def up(self) -> None:
        self.generation += 1
        self.world.after(self.world.random.uniform(0, 3), lambda g=self.generation: self.offer(g))  # type: ignore[misc]

    def down(self) -> None:
        self.generation += 1

    def offer(self, generation: int) -> None:
        session, rng = self.session, self.world.random
        if generation != self.generation or session is None or not session.may_send("BoardAvailable") or session.moving:
            return
        if self.board is None:
            self.board = self.line.next_board()
        board = self.board
        if board is None:
            return
        if rng.random() < 0.2:
            self.send(Message.of("BoardForecast", FailedBoard=0, FlippedBoard=0, BoardId=board.id))
        failed = next(code for code, name in FAILED.items() if name == board.failed)
        values = {"BoardId": board.id, "BoardIdCreatedBy": "upstream", "FailedBoard": failed, "FlippedBoard": "1"}
        self.send(Message("BoardAvailable", values))
        if rng.random() < 0.15:
            self.world.after(rng.uniform(0, 4), lambda: self.revoke(generation))

    def revoke(self, generation: int) -> None:
        session = self.session
        if generation != self.generation or session is None or session.moving:
            return
        if session.may_send("RevokeBoardAvailable"):
            self.send(Message.of("RevokeBoardAvailable"))
            self.world.after(self.world.random.uniform(0, 3), lambda: self.offer(generation))

    def take(self, message: Message) -> None:
        if message.tag == "StartTransport":
            board, rng = self.board, self.world.random
            assert board is not None
            assert board.id == message.get("BoardId")
            what = rng.choices(("3", "1", "2"), (0.95, 0.03, 0.02))[0]
            if what == "3":
                self.board = None
                self.line.travels(board)
            elif what == "2":
                self.board = None
                self.line.stands_between(board)
            late_s = 80.0 if rng.random() < 0.01 else rng.uniform(0.3, 3)
            self.world.after(late_s, lambda g=self.generation: self.finish(g, board, what))  # type: ignore[misc]
        elif message.tag == "StopTransport":
            self.world.after(self.world.random.uniform(0, 3), lambda g=self.generation: self.offer(g))  # type: ignore[misc]

    def finish(self, generation: int, board: Board, what: str) -> None:
        session = self.session
        if generation == self.generation and session is not None and session.may_send("TransportFinished"):
            self.send(Message.of("TransportFinished", TransferState=what, BoardId=board.id))
            if session.state is State.IDLE:
                self.world.after(self.world.random.uniform(0, 3), lambda: self.offer(generation))


class Downstream(End):
    """Takes the boards; is ready or not, and stops a transfer before or after its end."""

    def __init__(self, world: World, line: Line) -> None:
        self.world, self.line, self.generation, self.transfer = world, line, 0, 0
        self.offered: Message | None = None

    def up(self) -> None:
        self.generation += 1
        self.offered = None
        self.world.after(self.world.random.uniform(0, 3), lambda g=self.generation: self.ready(g))  # type: ignore[misc]

    def down(self) -> None:
        self.generation += 1

    def ready(self, generation: int) -> None:
        session, rng = self.session, self.world.random
        if generation != self.generation or session is None or not session.may_send("MachineReady"):
            return
        self.send(Message.of("MachineReady", FailedBoard=0))
        if rng.random() < 0.15:
            self.world.after(rng.uniform(0, 3), lambda: self.unready(generation))
        self.begin(generation)

    def unready(self, generation: int) -> None:
        session = self.session
        if generation == self.generation and session is not None and session.may_send("RevokeMachineReady"):
            self.send(Message.of("RevokeMachineReady"))
            self.world.after(self.world.random.uniform(0, 3), lambda: self.ready(generation))

    def begin(self, generation: int) -> None:
        session = self.session
        if generation != self.generation or session is None or session.state is not State.BOTH:
            return
        assert self.offered is not None
        offered, rng = self.offered, self.world.random
        self.send(Message.of("StartTransport", BoardId=session.board))
        self.transfer += 1
        what = rng.choices(("3", "1", "2"), (0.95, 0.03, 0.02))[0]
        self.world.after(0.2, lambda t=self.transfer: self.board_moves(generation, t, offered, what))  # type: ignore[misc]
        if what != "3" or rng.random() < 0.3:
            self.world.after(rng.uniform(0.4, 1.5), lambda t=self.transfer: self.stop(generation, t, what))  # type: ignore[misc]

    def board_moves(self, generation: int, transfer: int, offered: Message, what: str) -> None:
        # Else it stands between the machines, was not started, or the connection has ended before it moved.
        session = self.session
        same = (generation, transfer) == (self.generation, self.transfer)
        runs = self.line.started == offered.values["BoardId"]
        if same and runs and what == "3" and session is not None and session.moving:
            self.line.leaves(offered)

    def stop(self, generation: int, transfer: int, what: str) -> None:
        session, same = self.session, (generation, transfer) == (self.generation, self.transfer)
        if same and session is not None and session.may_send("StopTransport"):
            self.send(Message.of("StopTransport", TransferState=what, BoardId=session.board))
            if session.state is State.IDLE:
                self.world.after(self.world.random.uniform(0, 3), lambda: self.ready(generation))

    def take(self, message: Message) -> None:
        if message.tag == "BoardAvailable":
            self.offered = message
            self.world.after(self.world.random.uniform(0, 1), lambda g=self.generation: self.begin(g))  # type: ignore[misc]
        elif message.tag == "TransportFinished":
            session, generation = self.session, self.generation
            assert session is not None
            if session.state is State.FINISHED:
                self.stop(generation, self.transfer, message.values["TransferState"])
            else:
                self.world.after(self.world.random.uniform(0, 3), lambda: self.ready(generation))


class OfStation(End):
    """The station's end on one side."""

    def __init__(self, side: Side, line: Line) -> None:
        self.side, self.line = side, line

    def up(self) -> None:
        assert self.session is not None
        self.line.lane.connected(self.side, self.session, self.line.world.now_s)

    def take(self, message: Message) -> None:
        if self.side == "downstream":
            # The belt runs from StartTransport to StopTransport, or until the station misses its neighbour.
            self.line.started = message.get("BoardId") if message.tag == "StartTransport" else None
        self.line.lane.received(self.side, message, self.line.world.now_s)

    def down(self) -> None:
        if self.side == "downstream":
            self.line.started = None
        self.line.lane.lost(self.side, "cut", self.line.world.now_s)


@dataclass
class Score:
    """What became of the boards."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    decisions_s: list[float] = field(default_factory=list)
    stuck: str = ""
    restarts: int = 0


class Line:
    """The belt, its three machines, and a person who takes boards off it."""

    def __init__(self, seed: int, boards: int) -> None:
        self.world = world = World(seed)
        self.score, self._boards, self._made, self._runs = Score(), boards, 0, 0
        self._by_hand = 0
        self.behind: list[Board] = []
        """Boards behind the cameras, the first one first; a board that the next machine took is not there."""
        self.filmed: list[Board] = []
        """Boards between the barrier and the place behind the cameras, the first one first."""
        self.started: str | None = None
        """The board that the belt moves to the next machine."""
        self._moved_s = self._filmed_s = self._arrives_s = 0.0
        self.orders = QueuedOrders(world)
        ends: dict[Side, End] = {"upstream": OfStation("upstream", self), "downstream": OfStation("downstream", self)}
        self._send = lambda side, message: ends[side].send(message)
        self.lane = self._new_lane()
        decisions = self.score.decisions_s
        self._wires = (
            Wire(world, Upstream(world, self), ends["upstream"], decisions, "receiver"),
            Wire(world, ends["downstream"], Downstream(world, self), decisions, "sender"),
        )
        world.after(world.random.uniform(50, 2000), self._restart)
        world.after(world.random.uniform(20, 300), self._put_in)
        self._tick()

    def _new_lane(self) -> Lane:
        config = Hermes(upstream="upstream", listen="127.0.0.1", places=2, exit_s=2)
        return Lane(config, STATION, 100.0, self.orders, self._send, self._publish, transfer_s=LONGEST_S)

    def run(self) -> Score:
        """Let all boards pass."""
        while self.score.counts.total() < self._boards + self._by_hand:
            self.world.step()
            if self.world.now_s - self._moved_s > STUCK_S:
                sessions = {side: str(session.state) for side, session in self.lane.sessions.items()}
                self.score.stuck = f"at {self.world.now_s:.0f} s: {sessions}, {self.lane.held}, {self.lane.waiting}"
                break
        return self.score

    # --- what happens on the belt

    def next_board(self) -> Board | None:
        if self._made == self._boards:
            return None
        self._made += 1
        board, rng = self._new_board(), self.world.random
        if rng.random() < 0.5:
            self.orders.post(board.id if rng.random() < 0.6 else None)
        return board

    def _new_board(self, *, by_hand: bool = False) -> Board:
        rng = self.world.random
        name = str(uuid.UUID(int=rng.getrandbits(128)))
        return Board(self._made, name, rng.choice(tuple(FAILED.values())), by_hand=by_hand)

    def _end(self, board: Board, how: str) -> None:
        assert board.where != "gone"
        board.where = "gone"
        self.score.counts[f"put in by hand, {how}" if board.by_hand else how] += 1
        self._moved_s = self.world.now_s

    def travels(self, board: Board) -> None:
        if self.world.random.random() < 0.02:
            self._end(board, "taken off before the barrier")
            return
        late = self.world.random.random() < 0.03
        self._comes(board, (LONGEST_S, 2 * LONGEST_S + LATE_S) if late else (SHORTEST_S, LONGEST_S))

    def _comes(self, board: Board, way_s: tuple[float, float]) -> None:
        """Let a board reach the barrier. None overtakes another."""
        self._arrives_s = max(self._arrives_s + 0.1, self.world.now_s + self.world.random.uniform(*way_s))
        self.world.after(self._arrives_s - self.world.now_s, lambda: self._barrier(board))

    def _put_in(self) -> None:
        """A person puts a board on the belt before the barrier, while none can be there that was announced."""
        self.world.after(self.world.random.uniform(20, 300), self._put_in)
        if not self.orders.queue._at(self.world.now_s) and self._made < self._boards:
            self._by_hand += 1
            self._barrier(self._new_board(by_hand=True))

    def stands_between(self, board: Board) -> None:
        # A person takes most of them out; some go on, as late as any board.
        if self.world.random.random() < 0.7:
            self._end(board, "taken off between the machines")
        else:
            self._comes(board, (SHORTEST_S, LONGEST_S))

    def _barrier(self, board: Board) -> None:
        self._runs, board.where, now_s = self._runs + 1, "cameras", self.world.now_s
        self.filmed.append(board)
        if missed := self.world.random.random() < 0.03:
            self.orders.missed()
            self.lane.run_ended(None, now_s)
        else:
            self.orders.barrier(f"run-{self._runs}")
            self.lane.run_began(f"run-{self._runs}", now_s)
        # No board overtakes another.
        self._filmed_s = max(self._filmed_s, now_s + (0.0 if missed else self.world.random.uniform(1, 3)))
        run = None if missed else f"run-{self._runs}"
        self.world.after(self._filmed_s - now_s, lambda: self._stands_behind(board, run))

    def _stands_behind(self, board: Board, run: str | None) -> None:
        if board not in self.filmed:
            return  # the station was killed meanwhile
        self.filmed.remove(board)
        board.where = "behind"
        self.behind.append(board)
        if run is not None:
            order = self.orders.of_run(run)
            if order is not None and {order.board_id, order.job_id} - {board.id, None}:
                self.score.wrong.append(f"the run of board {board.number} has the order of {order.board_id}")
            self.lane.run_ended(run, self.world.now_s)
        if self.world.random.random() < 0.03:
            self.world.after(self.world.random.uniform(0, 10), lambda: self._take_off(board))

    def _restart(self) -> None:
        """Kill the station and start it again: it knows of the boards behind the barrier what it has kept."""
        kept, self.started = self.lane.to_keep(), None
        for wire in self._wires:
            wire.cut(wire.generation)
        for board in self.filmed:
            board.where = "behind"
        self.behind, self.filmed = [*self.behind, *self.filmed], []
        self.orders = QueuedOrders(self.world, self.orders.queue.kept)
        self.orders.by_messages(True)
        self.lane = self._new_lane()
        self.lane.waiting.extend(kept)
        self.score.restarts += 1
        self._publish("", "")
        self.world.after(self.world.random.uniform(50, 2000), self._restart)

    def _take_off(self, board: Board) -> None:
        """A person takes a board off behind the cameras, if the station lets him, and says so."""
        if board.where != "behind" or (place := self.behind.index(board)) >= len(self.lane.waiting):
            return
        if self.lane.waiting[0].doubtful:
            return  # the page asks for that board first
        if self.lane.remove(self.lane.waiting[place].board_id, self.world.now_s):
            self.behind.remove(board)
            self._end(board, "taken off behind the cameras")

    def leaves(self, offered: Message) -> None:
        """The first board moves on: its id must be that of the offer."""
        board = self.behind.pop(0)
        its_own = offered.values["BoardIdCreatedBy"] == STATION
        if not its_own and offered.values["BoardId"] != board.id:
            self.score.wrong.append(f"board {board.number} got the id of another")
        if not its_own and FAILED[offered.values["FailedBoard"]] != board.failed:
            self.score.wrong.append(f"board {board.number} was {board.failed}, and passed as {offered}")
        self._end(board, "passed without an id" if its_own else "passed with its id")

    def _publish(self, _kind: str, _message: str, **_more: Any) -> None:
        waiting = self.lane.waiting
        if waiting and waiting[0].doubtful:
            self.world.after(self.world.random.uniform(1, 60), lambda b=waiting[0].board_id: self._look(b))  # type: ignore[misc]

    def _look(self, board_id: str) -> None:
        """A person looks whether the doubtful board stands there, takes it out, and says that it is out."""
        waiting = self.lane.waiting
        if not waiting or waiting[0].board_id != board_id or not waiting[0].doubtful:
            return
        if len(self.behind) == len(waiting):
            self._end(self.behind.pop(0), "taken off after a doubt")
        assert self.lane.remove(board_id, self.world.now_s)

    def _tick(self) -> None:
        self.lane.decide(self.world.now_s)
        self.world.after(0.1, self._tick)


def percentile_ms(times_s: list[float], share: float) -> float:
    """Return the time below which this share lies, ms."""
    return sorted(times_s)[int(share * (len(times_s) - 1))] * 1e3


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    score = Line(given.seed, given.boards).run()
    for how, count in sorted(score.counts.items()):
        print(f"{count:6} {how}")
    print(f"{score.restarts:6} restarts")
    print(f"{len(score.wrong):6} wrong {score.wrong[:5]}")
    median_ms, late_ms = (percentile_ms(score.decisions_s, share) for share in (0.5, 0.99))
    print(f"message to decision: median {median_ms:.2f} ms, p99 {late_ms:.2f} ms")
    print(score.stuck or "not stuck")
    raise SystemExit(bool(score.wrong or score.stuck))
