"""The cameras of the array: each continues after a loss of its connection, because a supervisor opens it again.

While a camera is lost, the `AravisCamera` object keeps its slots and gives them to the new connection. Only one camera
of the process is opened at a time.
"""

from __future__ import annotations

import gc
import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from queue import SimpleQueue

from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.connection import (
    OPENING_LOCK,
    Connection,
    Identity,
    PortShare,
    absence_error,
    check_silence,
    locate,
    locate_each,
)
from vaoi_station.acquisition.cameras.aravis.links import check_row, sender_of
from vaoi_station.acquisition.cameras.aravis.recovery import (
    ABSENT_LIMIT_S,
    POWER,
    REOPEN,
    RESET,
    RESTART,
    Recovery,
    switch_power,
)
from vaoi_station.acquisition.cameras.aravis.stream import SlotResult
from vaoi_station.acquisition.cameras.interface import (
    Arrival,
    CameraBack,
    CameraEvent,
    CameraExposure,
    CameraHealth,
    CameraLost,
    DeviceFault,
    Slot,
)
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import CameraConfig, CameraPowerConfig, StationConfig
from vaoi_station.errors import DeviceError, InputError, VaoiError
from vaoi_station.optics.links import share_links
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

CHECK_S = 0.25
HEARTBEAT_S = 1.0
"""Interval at which Aravis checks that it still controls a camera. The state that Aravis reports may be this old."""
OPENING_LIMIT_S = 60.0
"""Longest time for opening a camera: each access to one that has just gone takes 2.6 s (measured)."""
TEMPERATURE_S = 5.0
"""Interval of temperature readings: every reading costs a round trip to the camera."""
PACE = BackoffPolicy(first_s=0.25, longest_s=30.0, proven_s=10.0)
"""Pauses between attempts to open a lost camera: one that refuses its settings will probably refuse them again."""
ABSENT_S = 2.0
"""The longest pause for a camera that is absent or used by another program: it may return at any time."""
_ABSENT = frozenset({"camera-absent", "camera-in-use", "camera-lost", "camera-hangs"})


@dataclass
class Unopened:
    """A camera that could not be opened at the start: its settings, why, and what it gets of the links."""

    config: CameraConfig
    fault: VaoiError
    share: PortShare = field(default_factory=PortShare)


class AravisCamera:
    """A `CameraDevice` that keeps its number and its slots while its `Connection` is lost and replaced by a new one."""

    def __init__(self, number: int, given: Connection | Unopened, power: CameraPowerConfig | None = None) -> None:
        """Take over an open, configured connection and start the acquisition; a camera that is not open counts as lost.

        `power` switches the camera's power.
        """
        connection = given if isinstance(given, Connection) else None
        self._power, self._recovery = power, Recovery()
        self._power_is_due = False
        self._silent_rows = 0
        """Rows of a run of which this camera sent nothing; 0 once the supervisor has taken note."""
        self.number, self.config, self._share = number, given.config, given.share
        self._sequence = connection.sequence if connection else ()
        self._identity = (
            connection.identity if connection else Identity(self.config.serial or "", self.config.address or "", "")
        )
        self._is_gige = connection.is_gige if connection else bool(self.config.address)
        self._epoch_ns = _epoch_ns(connection) if connection else 0
        """Value of the camera's clock, ns, from which its seconds count. Small numbers of seconds are exact to the ns
        in a float.
        """
        self._lock = threading.Lock()
        self._setting = threading.Lock()
        """Lock that guards the wanted exposure while it is written: the supervisor must not write it a second time."""
        self._connection: Connection | None = connection
        self._waiting: list[Slot] = []
        self._arrivals: SimpleQueue[CameraEvent] = SimpleQueue()
        self._delivered = self._incomplete = self._losses = 0
        self._last_frame_s: float | None = None
        self._last_slot_s = -math.inf
        """Last monotonic time, s, at which a frame ended, complete or incomplete."""
        self._temperature_c: float | None = None
        self._counting = threading.Lock()
        self._fault: VaoiError | None = None if isinstance(given, Connection) else given.fault
        self._access_error: DeviceError | None = None
        self._backoff = Backoff(PACE)
        self._last_reply_s = time.monotonic()
        """Monotonic time, s, at which the camera last replied."""
        self._last_controlled_s = self._last_reply_s
        """Last monotonic time, s, at which this process certainly controlled the camera."""
        self._closing = threading.Event()
        self._thread = SupervisedThread(self._supervise, f"camera-{self.config.name}", OPENING_LIMIT_S)
        if connection is not None:
            connection.start(self._on_slot)

    def start(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Start the supervisor. It puts arrivals of frames, and losses and returns of the camera, into `arrivals`."""
        self._arrivals = arrivals
        if self._fault is not None:
            self._report_loss(self._fault)
        self._thread.start()

    def set_exposure(self, wanted: CameraExposure) -> None:
        """Write exposure and gain, read them back and compare. A lost camera gets them when it is opened again."""
        way = "trigger-width" if wanted.by_trigger else "register"
        # Whether frames have chunk data is not changed.
        by = "sequencer" if self.config.exposure_by == "sequencer" else way
        update = {"exposure_us": wanted.exposures_us[0], "gain_db": wanted.gain_db, "exposure_by": by}
        with self._setting:
            before, connection = (self.config, self._sequence), self._connection
            # A connection that is opened later writes these settings.
            self.config, self._sequence = self.config.model_copy(update=update), wanted.sequence
            try:
                if connection is not None:
                    self._bring_up_to_date(connection)
            except DeviceError:
                self.config, self._sequence = before
                raise

    def replace(self, serial: str, address: str) -> None:
        """Use another camera from now on: the supervisor gives up the one before, if it is there, and opens it."""
        with self._setting:
            self.config = self.config.model_copy(update={"serial": serial, "address": None})
            self._identity = replace(self._identity, serial=serial, address=address)
        self._recovery.filmed()  # what was tried, was tried with the camera before

    def rewind(self) -> None:
        """Begin the sequence of exposures anew. A lost camera begins it when it is opened again."""
        connection = self._connection
        try:
            if connection is not None:
                connection.rewind()
        except DeviceError as error:
            self._note_access_error(connection, error)

    def _note_access_error(self, connection: Connection | None, error: DeviceError) -> None:
        """Let the supervisor know of an error of the present connection.

        An access to a camera that is gone fails after 2.6 s only. Another one may have its place by then.
        """
        if connection is self._connection:
            self._access_error = error

    def sent_nothing(self, rows: int, since_s: float) -> None:
        """Let the supervisor take the next step against a camera that hangs."""
        if self._last_slot_s < since_s:  # else it sent frames that belong to no row, or incomplete ones
            self._silent_rows = rows

    def queue(self, slot: Slot) -> None:
        """Give a slot to the stream. While the camera is lost, keep the slot until the camera is back."""
        with self._lock:
            if self._connection is None:
                self._waiting.append(slot)
            else:
                self._connection.stream.queue(slot)

    def take_back(self) -> list[int]:
        """Take back the unused slots and return their numbers. After the call no frame is written to these slots."""
        with self._lock:
            unused, self._waiting = self._waiting, []
            if self._connection is not None:
                unused = unused + self._connection.stream.take_back()
            return [slot.number for slot in unused]

    def read_clock(self) -> ClockReading:
        """Compare the camera's clock with the host's. Raise DeviceError without waiting while the camera is lost."""
        connection = self._connection
        if connection is None:
            raise self._fault or absence_error(self.config, self._identity.address, "it was lost")
        try:
            return connection.read_clock(self._epoch_ns)
        except DeviceError as error:
            # The supervisor, not this thread, decides whether the camera is lost: only it may replace the connection.
            self._note_access_error(connection, error)
            raise

    def health(self) -> CameraHealth:
        """Return the state, counts and temperature of the camera. Never block."""
        # The connection is read only once, because the supervisor may drop it between two uses.
        connection = self._connection
        lost = self._fault if connection is None else None
        counters = connection.counters() if connection is not None else {}
        return CameraHealth(
            connected=connection is not None,
            message=lost.message
            if lost
            else self._recovery.message() or (connection.warning() if connection is not None else ""),
            action=lost.action if lost else "",
            temperature_c=self._temperature_c if connection is not None else None,
            delivered=self._delivered,
            incomplete=self._incomplete,
            last_frame_s=self._last_frame_s,
            counters=tuple(sorted({**counters, "n_losses": self._losses}.items())),
            next_try_s=self._backoff.due_s,
            recovery=self._recovery.state,
            limits=replace(connection.limits, row_s=self._share.row_s) if connection is not None else None,
            serial=self._identity.serial,
            model=self._identity.model,
            address=self._identity.address,
            ptp=replace(connection.ptp, epoch_ns=self._epoch_ns) if connection and connection.ptp else None,
        )

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the supervisor and, unless the camera is lost, the thread that receives frames."""
        connection = self._connection
        return (self._thread, *(connection.threads() if connection is not None else ()))

    def close(self) -> None:
        """End the supervisor, stop the camera and release it."""
        self._thread.expect_end()
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join()
        with self._lock:
            connection, self._connection = self._connection, None
        if connection is not None:
            # Stopping an absent camera blocks: each access to it takes 2.6 s before it fails (measured, Aravis 0.8.26).
            connection.close(gone=self._is_gige and not network.is_reachable(self._identity.address, tries=1))

    def _on_slot(self, result: SlotResult) -> None:
        """Count a slot in which a frame has ended, complete or incomplete, and report the frame as an arrival."""
        # Called by the pulling thread and by any thread that takes slots back.
        if result.whole:
            self._recovery.filmed()
        with self._counting:
            self._last_slot_s = result.host_time_s
            if result.whole:
                self._delivered += 1
                self._last_frame_s = result.host_time_s
            else:
                self._incomplete += 1
        time_s = None if result.time_ns is None else (result.time_ns - self._epoch_ns) * 1e-9
        taken = result.whole, result.frame_id, time_s, result.host_time_s, result.fault, result.stated
        self._arrivals.put(Arrival(self.number, result.slot.number, *taken))

    def _supervise(self) -> None:
        temperature_due_s = 0.0
        self._backoff.record_success()
        while not self._closing.wait(CHECK_S if self._connection else min(self._backoff.remaining_s(), ABSENT_S)):
            self._thread.beat()
            if self._connection is None:
                self._switch_power_when_due()
                self._reopen_when_due()
                continue
            try:
                self._check(self._connection)
                self._answer_silence(self._connection)
                # A refusal leaves a part of the refused values in the camera.
                with self._setting:
                    self._bring_up_to_date(self._connection)
                if time.monotonic() >= temperature_due_s:
                    self._connection.read_ptp()
                    self._temperature_c = self._connection.temperature_c()
                    temperature_due_s = time.monotonic() + TEMPERATURE_S
            except DeviceError as error:
                self._on_loss(error)

    def _bring_up_to_date(self, connection: Connection) -> None:
        """Write exposure, gain and sequence to the camera if they are not those in force.

        DeviceError: they are refused, or another camera has its place meanwhile.
        """
        if connection.config.serial != self.config.serial:
            raise DeviceError(
                f"{self.config.label}: another camera, {self.config.serial}, is to have its place.",
                action="It is opened automatically.",
                code="camera-lost",
            )
        if not connection.has_exposure(self.config, self._sequence):
            connection.set_exposure(self.config, self._sequence)

    def _reopen_when_due(self) -> None:
        """Try to open the camera if its back-off permits an attempt. An unplugged camera ends the back-off."""
        if self._backoff.remaining_s() > 0:
            if self._is_gige and not network.is_reachable(self._identity.address):
                self._backoff.reset()
            return
        self._backoff.start_attempt()
        if self._reopen():
            self._backoff.record_success()
        else:
            self._record_failure()

    def _record_failure(self) -> None:
        absent = self._fault is not None and self._fault.code in _ABSENT
        self._backoff.record_failure(ABSENT_S if absent else PACE.longest_s)

    def _check(self, connection: Connection) -> None:
        """Raise DeviceError if the camera is absent, or no longer controlled by this process."""
        asked_s = time.monotonic()
        # The camera itself is asked whether it has a controller. After a stop of this process (SIGSTOP), Aravis' own
        # state may be a second old, and a board that passes then would be filmed by a camera that does not send.
        control = network.read_control(self._identity.address) if self._is_gige else network.Control.CONTROLLED
        if control is network.Control.ABSENT:
            raise absence_error(self.config, self._identity.address, "it does not answer any more")
        if control is network.Control.FREE or not connection.is_controller():
            # Frames may be missing since the last moment of certain control, not only since the last reply.
            self._last_reply_s = self._last_controlled_s
            raise DeviceError(
                f"{self.config.label}: is no longer controlled by this station: it has restarted, this computer sent "
                "no heartbeat for too long, or another program has taken it.",
                action="Check its power, and close other programs that use it; it is opened again automatically.",
                code="camera-lost",
            )
        access_error, self._access_error = self._access_error, None
        if access_error is not None:
            raise access_error
        self._last_reply_s = asked_s
        self._last_controlled_s = max(self._last_controlled_s, asked_s - HEARTBEAT_S)

    def _answer_silence(self, connection: Connection) -> None:
        """Take the next step if the camera sent nothing of a run; DeviceError if the connection must be dropped."""
        rows, self._silent_rows = self._silent_rows, 0
        if not rows:
            return
        possible = {REOPEN, RESTART} | ({POWER} if self._power is not None else set())
        step = self._recovery.next_step(possible | ({RESET} if connection.resettable else set()))
        if step is None:
            return
        what = f"{self.config.label}: answers, but sent nothing of {rows} rows"
        action = "Check that its trigger line is wired, and its power and cable, if this goes on."
        error = DeviceError(f"{what}; {step.done}.", action=action, code="camera-hangs")
        _log.warning("%s", error.message)
        if step is RESTART:
            connection.restart()
            self._arrivals.put(DeviceFault(self.config.label, error))
            return
        if step is RESET:
            connection.reset()
        self._power_is_due = step is POWER
        raise error

    def _switch_power_when_due(self) -> None:
        """Run the command for the camera's power if it is the next step, or if the camera is deaf on a link."""
        if self._power is None:
            return
        absent = self._fault is not None and self._fault.code == "camera-absent"
        if absent and self._is_gige and time.monotonic() - self._last_reply_s > ABSENT_LIMIT_S:
            # A camera that was deaf at the start of the station has never said on which port it is.
            port = self._identity.interface or network.interface_towards(self._identity.address)
            linked = network.has_link(port)
            self._power_is_due |= linked and self._recovery.take(POWER, "absent")
        if not self._power_is_due:
            return
        self._power_is_due = False
        names = {"name": self.config.name, "address": self._identity.address, "serial": self._identity.serial}
        _log.warning("%s: its power is switched off and on", self.config.label)
        with self._thread.waiting():
            failure = switch_power(self._power, names)
        if failure:
            message = f"{self.config.label}: its power could not be switched: {failure}."
            error = DeviceError(message, action="Run the command of camera_power by hand.", code="camera-power")
            _log.error("%s", error.message)
            self._arrivals.put(DeviceFault(self.config.label, error))

    def _on_loss(self, error: DeviceError) -> None:
        """Take the slots back from the lost connection, report the loss, and close the connection in the background."""
        self._fault = _detached(error)
        with self._lock:
            connection, self._connection = self._connection, None
            assert connection is not None
            # The stream's slots come first: they were queued before the waiting slots, and this order is kept.
            self._waiting = connection.stream.close() + self._waiting
        self._losses += 1
        self._record_failure()
        self._report_loss(error)
        connection.close(gone=True)

    def _report_loss(self, error: VaoiError) -> None:
        why = error.message.removeprefix(f"{self.config.label}: ").rstrip(".")
        self._arrivals.put(CameraLost(self.number, self._last_reply_s, why, error))

    def _reopen(self) -> bool:
        """Try once to open the camera and to start it; return whether this succeeded."""
        try:
            with self._thread.waiting():
                OPENING_LOCK.acquire()  # a camera that hangs while it is opened is reported by its own supervisor
            try:
                connection = self._connect()
            finally:
                OPENING_LOCK.release()
        except VaoiError as error:
            self._fault = _detached(error)
            return False
        try:
            self._thread.beat()
            connection.await_ptp(self._closing)
            if not self._epoch_ns:  # it was never open before
                self._epoch_ns = _epoch_ns(connection)
            reading = connection.read_clock(self._epoch_ns)
            # Exposure or gain may have been set while the camera was opened with the values of before. Slots follow
            # them: no frame of a board may have those values.
            with self._setting:
                self._bring_up_to_date(connection)
                with self._lock:
                    # The clock reading comes before the first frame: it begins an epoch with a new clock model.
                    self._arrivals.put(CameraBack(self.number, time.monotonic(), reading))
                    for slot in self._waiting:
                        connection.stream.queue(slot)
                    self._waiting, self._connection, self._access_error = [], connection, None
        except DeviceError as error:
            self._fault = _detached(error)
            connection.close()
            return False
        self._last_reply_s = self._last_controlled_s = time.monotonic()
        return True

    def _connect(self) -> Connection:
        # All objects are built anew: with the old ones `start_acquisition` raises nothing after a reconnection, and no
        # frame arrives (measured, Aravis 0.8.26; camera_aravis2 #41 and Aravis #735 report failures there).
        connection = Connection(self.config, self._locate(), self._sequence, self._share)
        try:
            # Empty: a camera that was never there is known by its address only.
            connection.require_serial(self._identity.serial)
            connection.configure()
            connection.start(self._on_slot)
        except BaseException:  # also KeyboardInterrupt: release the camera, then raise it again
            connection.close()
            raise
        with self._setting:
            if self._identity.serial in ("", connection.identity.serial):  # not exchanged meanwhile
                self._identity, self._is_gige = connection.identity, connection.is_gige
        return connection

    def _locate(self) -> str:
        """Return the camera's last address if it replies there, else the address found by its serial number."""
        if self._is_gige and network.is_reachable(self._identity.address, tries=1):
            return self._identity.address
        if self.config.serial is None:
            raise absence_error(self.config, self._identity.address, "it does not answer")
        return locate(self.config)


STALL_S = 1.0
"""Longest pause of this process during which the kernel's receive buffer can hold all frames of a camera."""


def open_aravis_cameras(config: StationConfig) -> tuple[AravisCamera, ...]:
    """Open every camera of a station. Those that cannot be opened are lost from the start; one at least must open."""
    members: list[Connection | Unopened] = []
    cameras: list[AravisCamera] = []
    with OPENING_LOCK:
        try:
            for camera, where in zip(config.cameras, locate_each(config.cameras), strict=True):
                # Until a light program is armed, the register holds the exposure: pulses without a program use it.
                by = camera.exposure_by if camera.exposure_by == "sequencer" else "register"
                members.append(_opened(camera.model_copy(update={"exposure_by": by}), where))
            _check_distinct(_open(members))
            _each(members, Connection.measure_link)
            _share_links(config, members)
            _each(members, Connection.configure)
            # Shared again: a camera may keep a lower limit than its share.
            _share_links(config, members)
            _each(members, Connection.await_ptp)
            for connection in _open(members):
                _log.info("%s", connection.link_text())
            for number, member in enumerate(members):
                cameras.append(AravisCamera(number, member, config.camera_power))
            # Checked last, with all cameras started: a camera that sends now would have its frames in wrong rows.
            check_silence(_open(members))
        except BaseException:  # also KeyboardInterrupt: release all cameras; it is raised on
            # An AravisCamera closes its connection; connections without an AravisCamera are closed one by one.
            for opened in cameras:
                opened.close()
            for unused in _open(members[len(cameras) :]):
                unused.close()
            raise
    return tuple(cameras)


def _opened(config: CameraConfig, where: str | VaoiError) -> Connection | Unopened:
    if isinstance(where, VaoiError):
        return Unopened(config, where)
    connection = None
    try:
        connection = Connection(config, where)
        if config.address is not None:
            connection.require_serial(config.serial)
    except VaoiError as error:
        if connection is not None:
            connection.close()
        return Unopened(config, _detached(error))
    return connection


def _open(members: Sequence[Connection | Unopened]) -> list[Connection]:
    return [member for member in members if isinstance(member, Connection)]


def _each(members: list[Connection | Unopened], step: Callable[[Connection], None]) -> None:
    """Do a step with all open cameras at the same time. Those that refuse it are closed; raise if all do."""

    def attempt(connection: Connection) -> Connection | Unopened:
        try:
            step(connection)
        except VaoiError as error:
            refused = Unopened(connection.config, _detached(error))
            connection.close()
            return refused
        return connection

    # A camera may take a second to load its user set, and hundreds of round trips for its settings.
    with ThreadPoolExecutor(max(1, len(members)), "open-camera") as pool:
        stepped = iter(list(pool.map(attempt, _open(members))))
    members[:] = [next(stepped) if isinstance(member, Connection) else member for member in members]
    faults = [member.fault for member in members if isinstance(member, Unopened)]
    if len(faults) == len(members):
        raise faults[0]


def socket_bytes(camera: CameraConfig, period_s: float) -> int:
    """Return the wanted size of the kernel's receive buffer, bytes: room for all frames of `STALL_S`, at least two."""
    return max(2, math.ceil(STALL_S / period_s)) * camera.frame_bytes


def receive_limit_bytes(cameras: Sequence[CameraConfig], period_s: float) -> int:
    """Return what net.core.rmem_max should permit: two frames of every camera, and all that one sends in `STALL_S`."""
    rows = 2 * len(cameras) * max(camera.frame_bytes for camera in cameras)
    return max(rows, *(socket_bytes(camera, period_s) for camera in cameras))


def _check_distinct(connections: Sequence[Connection]) -> None:
    counts = Counter(connection.identity.serial for connection in connections)
    for serial, count in counts.items():
        if count > 1:
            names = [c.config.name for c in connections if c.identity.serial == serial]
            raise InputError(
                f"cameras {', '.join(names)}: have the same serial number {serial!r}.",
                action="Check their addresses in station.toml; one camera cannot stand at two places.",
                code="camera-ambiguous",
            )


def _share_links(config: StationConfig, members: Sequence[Connection | Unopened]) -> None:
    """Share the links as if all cameras were there: one that is absent may come at any time."""
    there = _open(members)
    counts = Counter(connection.identity.interface for connection in there)
    packets = {connection.identity.interface: connection.sender.packet_bytes for connection in there}
    senders = []
    for member in members:
        if isinstance(member, Connection):
            senders.append(member.sender)
            continue
        port = network.interface_towards(member.config.address or "")
        # Without its address, nothing says where it hangs: most likely where cameras are missing.
        port = port if port in counts else min(counts, key=counts.__getitem__)
        counts[port] += 1
        senders.append(sender_of(member.config, port, None, packets[port]))
    period_s = config.line.shortest_period_s
    row_s = check_row(senders, period_s)
    for member, share in zip(members, share_links(senders), strict=True):
        buffer_bytes = socket_bytes(member.config, period_s)
        packet = member.packet_bytes if isinstance(member, Connection) else 0
        member.share = PortShare(math.ceil(share.delay_s * 1e9), share.mbit_s, row_s or None, buffer_bytes, packet)


def _detached(error: VaoiError) -> VaoiError:
    """Return an error without its tracebacks, whose frames would keep the camera open for the next attempt."""
    error.__cause__ = error.__context__ = None
    error.with_traceback(None)
    gc.collect()
    return error


def _epoch_ns(connection: Connection) -> int:
    return round(connection.read_clock(0).device_s * 1e9)
