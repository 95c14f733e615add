"""Check this machine: cache of compiled code, clock, memory for the ring, socket buffers, memory of USB."""

from __future__ import annotations

import ctypes
import math
import os
import pwd
import re
import resource
import socket
import stat
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vaoi_station import version
from vaoi_station.acquisition.cameras.aravis.camera import receive_limit_bytes
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import Machine, format_bytes, is_directory, writable
from vaoi_station.doctor.running_station import CheckContext

UNIT = "vaoi-station.service"
PACKAGE = Path(version.__file__).parent
TIME_ERROR = 5
"""Return value of adjtimex (TIME_ERROR): the clock is not synchronised."""
_MAX_ERROR_AT, _SIZE = 24, 256
"""Byte offset of `maxerror` in struct timex of 64-bit Linux; and a buffer size that is larger than this struct."""
USB_PER_CAMERA_MB = 8
"""Memory that Aravis submits at a time for each USB camera (ARV_UV_STREAM_MAXIMUM_SUBMIT_TOTAL)."""
CONNECT_S = 3.0
"""Longest wait for a machine of the line, s."""
USB_PARAMETER = "sys/module/usbcore/parameters/usbfs_memory_mb"
_SMALLER = "Lower [ring] runs or [line] longest_board_mm in station.toml"
_LOCK = (
    "Set LimitMEMLOCK=infinity for the service, as in deploy/vaoi-station.service; in a root shell: ulimit -l unlimited"
)


def compiled_code_cache(machine: Machine) -> Iterator[Finding]:
    """Check that Numba can store compiled inner loops, where the service does it: by its unit, as its user."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    unit = _unit_of_this_installation(machine)
    if given is None and unit is not None and unit.cache is not None:
        yield judge_cache_of_service(unit)
    else:
        yield judge_cache(given, PACKAGE, Path.home())


class ServiceUnit(NamedTuple):
    """The user and the cache directory that the systemd unit of the station states."""

    user: str
    cache: Path | None


def _unit_of_this_installation(machine: Machine) -> ServiceUnit | None:
    """Read the unit that runs the station of this environment; None if there is no such unit."""
    for place in ("etc/systemd/system", "usr/local/lib/systemd/system", "usr/lib/systemd/system"):
        text = machine.text(f"{place}/{UNIT}")
        if text is None:
            continue
        values = dict(re.findall(r"(?m)^(ExecStart|User)=(.*)$", text))
        if not values.get("ExecStart", "").startswith(f"{sys.prefix}/"):
            return None
        cache = re.search(r"(?m)^Environment=\"?NUMBA_CACHE_DIR=([^\"\n]+)", text)
        return ServiceUnit(values.get("User", "root").strip(), Path(cache[1].strip()) if cache else None)
    return None


def judge_cache_of_service(unit: ServiceUnit) -> Finding:
    """Judge the cache that the unit names by the rights of the service's user, not by those of who runs the doctor."""
    assert unit.cache is not None
    try:
        user = pwd.getpwnam(unit.user)
    except KeyError:
        message = f"the user {unit.user} of the service does not exist."
        action = f"useradd --system {unit.user}"
        return fault("service-user-absent", message, action, user=unit.user)
    action = f"install -d -o {unit.user} -g {unit.user} -m 750 {unit.cache}"
    figures: Figures = {"path": str(unit.cache)}
    try:
        status = unit.cache.stat()
    except FileNotFoundError:
        # CacheDirectory= of the unit makes it at the next start, with the right owner.
        return ok(f"will be stored in {unit.cache} by the service")
    except OSError as error:
        message = f"{unit.cache}, the cache of the service, cannot be examined ({error.strerror})."
        return warning("code-cache-unusable", message, action, **figures)
    groups = os.getgrouplist(unit.user, user.pw_gid)
    mode = status.st_mode >> (6 if status.st_uid == user.pw_uid else 3 if status.st_gid in groups else 0)
    if stat.S_ISDIR(status.st_mode) and (mode & 0o3 == 0o3 or user.pw_uid == 0):
        return ok(f"is stored in {unit.cache} by the service")
    message = f"{unit.cache} cannot be written to by {unit.user}, the user of the service: "
    message += "every start compiles for about a minute."
    return warning("code-cache-unusable", message, action, **figures)


def judge_cache(given: str | None, package: Path, home: Path) -> Finding:
    """Judge whether machine code can be kept: in NUMBA_CACHE_DIR if set, else in the package's or the user's folder."""
    # those of `vaoi_station.compiled.cache_directories`, for this package and home
    users = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    defaults = (package / "__pycache__" / "machine_code", users / "vaoi-station")
    places: tuple[Path, ...] = (Path(given),) if given else defaults
    for place in places:
        if writable(place):
            return ok(f"is stored in {place}")
    if given:
        message = f"NUMBA_CACHE_DIR={given} cannot be written to"
        action = f"install -d -o $USER {given}, or unset NUMBA_CACHE_DIR"
    else:
        message = f"neither {defaults[0]} nor {defaults[1]} can be written to"
        action = "Set NUMBA_CACHE_DIR to a directory of this user, as deploy/vaoi-station.service does."
    message += ": every start compiles for about a minute."
    return warning("code-cache-unusable", message, action, path=str(places[-1]))


def wall_clock(_: Machine) -> Iterator[Finding]:
    """Check that the machine's wall clock is synchronised by NTP or PTP."""
    # `modes` is the first field of the struct. Zero makes adjtimex read only, which needs no privilege.
    buffer = ctypes.create_string_buffer(_SIZE)
    state = ctypes.CDLL(None, use_errno=True).adjtimex(buffer)
    (max_error_us,) = struct.unpack_from("<q", buffer.raw, _MAX_ERROR_AT)
    yield judge_wall_clock(state, max_error_us)


def judge_wall_clock(state: int, max_error_us: int) -> Finding:
    """Judge what the system call adjtimex returns: the state of the wall clock, and the bound of its error."""
    if state < 0:
        return not_applicable("the kernel does not report whether the wall clock is synchronised")
    if state == TIME_ERROR:
        message = "the wall clock is not synchronised: names and times of runs drift away from those of other machines."
        return warning("wall-clock-free", message, "timedatectl set-ntp true", synchronised=False)
    figures: Figures = {"synchronised": True, "max_error_ms": round(max_error_us / 1e3, 3)}
    return ok(f"synchronised, error at most {max_error_us / 1e3:.0f} ms", **figures)


def ring_space(context: CheckContext) -> Iterator[Finding]:
    """Check that the ring of this configuration fits its directory and the machine's memory."""
    directory, needed = context.config.ring.directory, context.layout.file_bytes
    figures: Figures = {"path": str(directory)}
    if not is_directory(directory):
        action = "mount -t tmpfs tmpfs /dev/shm, or set [ring] directory"
        yield fault("ring-directory", f"there is no directory {directory} for the ring.", action, **figures)
        return
    if context.running is not None:
        message = f"{context.running.description} holds the ring of {format_bytes(needed)}"
        yield ok(message, ring_bytes=needed)
        return
    if not writable(directory):
        action = "chmod 1777 /dev/shm, or set [ring] directory"
        message = f"{directory} cannot be written to by this user."
        yield fault("ring-directory", message, action, **figures)
        return
    space = os.statvfs(directory)
    yield _judge_ring(context, needed, space.f_bavail * space.f_frsize, context.machine.available_memory())
    # Not a fault: a station with simulated cameras works from a disk too, and containers often have a small /dev/shm.
    kind = context.machine.filesystem_of(directory)
    if kind not in {"tmpfs", "ramfs", "hugetlbfs", None}:
        message = f"{directory} is on {kind}, not in memory: writing frames would wait for a disk."
        yield warning("ring-on-disk", message, "Set [ring] directory to /dev/shm.", **figures)


def _judge_ring(context: CheckContext, needed: int, free: int, available: int | None) -> Finding:
    layout, directory = context.layout, context.config.ring.directory
    figures: Figures = {"ring_bytes": needed, "free_bytes": free, "available_bytes": available}
    message = (
        f"the ring needs {format_bytes(needed)} ({layout.bays} runs × {layout.cameras} cameras × "
        f"{layout.slots_per_camera} rows × {format_bytes(layout.slot_bytes)})"
    )
    if free < needed:
        # The ring's pages count against the tmpfs limit; a tenth more leaves space for other programs' files.
        remount = f"mount -o remount,size={round(needed * 1.1 / 2**20) + 1}M {directory}"
        message += f"; {directory} has {format_bytes(free)} free."
        return fault("ring-too-large", message, f"{remount}; or: {_SMALLER}.", **figures)
    if available is not None and available < needed:
        message += f"; the machine has {format_bytes(available)} of memory left."
        return fault("ring-too-large", message, f"{_SMALLER}.", **figures)
    if available is not None and available < 1.5 * needed:
        message += f"; only {format_bytes(available - needed)} of memory remain for all other programs."
        return warning("memory-scarce", message, f"{_SMALLER}.", **figures)
    return ok(f"{message}; {directory} has {format_bytes(free)} free", **figures)


def lock_limit(context: CheckContext) -> Iterator[Finding]:
    """Check that a running station has locked its ring in memory; without one, that this user is permitted to do so."""
    needed, running = context.layout.file_bytes, context.running
    if running is not None and running.pid is None:
        yield not_applicable(f"{running.description} holds the ring; whether it is locked cannot be read")
    elif running is not None and running.pid is not None:
        yield judge_locked(context.machine.locked_bytes(running.pid), needed, running.pid)
    elif context.machine.may_lock_anything():
        yield ok("this user may lock memory without limit (CAP_IPC_LOCK)")
    else:
        yield judge_lock(resource.getrlimit(resource.RLIMIT_MEMLOCK)[0], needed)


def judge_locked(locked: int | None, needed: int, pid: int) -> Finding:
    """Judge how much memory a running station has locked."""
    figures: Figures = {"locked_bytes": locked, "ring_bytes": needed}
    if locked is not None and locked >= needed:
        return ok(f"process {pid} has locked its ring, {format_bytes(locked)}", **figures)
    message = f"process {pid} has not locked its ring: frames are late when memory is short."
    return warning("ring-not-locked", message, _LOCK, **figures)


def judge_lock(limit: int, needed: int) -> Finding:
    """Judge the limit of this user for locked memory (RLIMIT_MEMLOCK)."""
    figures: Figures = {"limit_bytes": limit, "ring_bytes": needed}
    if limit == resource.RLIM_INFINITY:
        return ok("this user may lock memory without limit", **figures)
    message = f"this user may lock {format_bytes(limit)} of memory"
    if limit >= needed:
        return ok(message, **figures)
    message += f", the ring has {format_bytes(needed)}: frames are late when memory is short."
    return warning("lock-limit-low", message, _LOCK, **figures)


def socket_buffers(context: CheckContext) -> Iterator[Finding]:
    """Check net.core.rmem_max, the upper limit of a socket's receive buffer."""
    if not context.real_cameras:
        yield not_applicable("no camera is on the network")
        return
    # The kernel reduces a larger request to this limit and reports no error.
    period_s = context.config.line.shortest_period_s
    needed = receive_limit_bytes(context.real_cameras, period_s)
    yield judge_buffers(context.machine.sysctl("net.core.rmem_max"), needed)


def judge_buffers(granted: int | None, needed: int) -> Finding:
    """Judge whether a socket buffer of the permitted size holds what arrives while the machine stalls."""
    figures: Figures = {"rmem_max_bytes": granted, "needed_bytes": needed}
    if granted is None:
        action = "Run sysctl net.core.rmem_max and correct what it reports."
        return fault("socket-buffer-unknown", "net.core.rmem_max cannot be read.", action, **figures)
    message = f"net.core.rmem_max is {format_bytes(granted)}, "
    if granted >= needed:
        return ok(f"{message}{format_bytes(needed)} are needed", **figures)
    message += f"but {format_bytes(needed)} are needed, two frames of every camera: frames are lost when it stalls."
    action = f"sysctl -w net.core.rmem_max={2 ** math.ceil(math.log2(needed))}; permanently: "
    action += "install -m 644 deploy/60-vaoi.conf /etc/sysctl.d/"
    return warning("socket-buffer-small", message, action, **figures)


def usb_memory(context: CheckContext) -> Iterator[Finding]:
    """Check usbfs_memory_mb: the kernel's limit must be enough for all cameras that may be connected by USB."""
    # Only a camera named by its serial number can be on USB: an address is always that of a GigE camera.
    named = sum(camera.serial is not None for camera in context.real_cameras)
    if named:
        yield judge_usb_memory(context.machine.number(USB_PARAMETER), named)
    else:
        yield not_applicable("no camera is named by a serial number, as USB cameras are")


def judge_usb_memory(granted_mb: int | None, cameras: int) -> Finding:
    """Judge whether the limit in MB suffices for this number of cameras. A limit of 0 means that there is no limit."""
    needed_mb = USB_PER_CAMERA_MB * cameras
    figures: Figures = {"usbfs_memory_mb": granted_mb, "needed_mb": needed_mb}
    if granted_mb is None:
        return not_applicable("this machine has no USB")
    if not 0 < granted_mb < needed_mb:
        return ok(f"usbfs_memory_mb is {granted_mb or 'without limit'}, {needed_mb} are needed", **figures)
    message = f"usbfs_memory_mb is {granted_mb}, {cameras} cameras on USB need {needed_mb}: the last ones do not start."
    action = f"echo 256 > /{USB_PARAMETER}; permanently: "
    action += "install -m 644 deploy/vaoi-usb-memory.conf /etc/tmpfiles.d/"
    return fault("usb-memory-small", message, action, **figures)


def upstream(context: CheckContext) -> Iterator[Finding]:
    """Check that the machine upstream in the line is reached, if no station runs that has a connection to it."""
    hermes = context.config.hermes
    if hermes is None or hermes.upstream is None:
        yield not_applicable("no machine upstream speaks Hermes")
    elif context.running is not None:
        yield not_applicable("the running station has the only connection: see GET neighbours")
    else:
        host, port = hermes.address(hermes.upstream)
        try:
            socket.create_connection((host, port), CONNECT_S).close()
        except OSError as error:
            message = f"hermes.upstream: {host}:{port} is not reached: {error.strerror or error}."
            action = "Switch the machine on, check cable, address, and that its Hermes lane is enabled."
            yield warning("neighbour-lost", message, action, "upstream")
        else:
            yield ok(f"the machine upstream is reached at {host}:{port}")
