"""Room for the ring, and leave to lock it."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator

from vaoi_station.doctor.check_context import Patient
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import is_directory, shown_bytes, writable

_SMALLER = "Lower [ring] runs or [line] longest_board_mm in station.toml"
_LOCK = "LimitMEMLOCK=infinity in the service, as in deploy/vaoi-station.service; in root's shell: ulimit -l unlimited"


def ring_space(patient: Patient) -> Iterator[Finding]:
    """Does the ring of this configuration fit?"""
    directory, needed = patient.config.ring.directory, patient.layout.file_bytes
    if not is_directory(directory):
        yield fault(
            f"there is no directory {directory} for the ring.", "mount -t tmpfs tmpfs /dev/shm, or set [ring] directory"
        )
        return
    if patient.running is not None:
        yield ok(f"{patient.running.who} has its ring of {shown_bytes(needed)}", figures={"ring_bytes": needed})
        return
    if not writable(directory):
        yield fault(f"{directory} cannot be written to by this user.", "chmod 1777 /dev/shm, or set [ring] directory")
        return
    space = os.statvfs(directory)
    free, available = space.f_bavail * space.f_frsize, patient.machine.available_memory()
    yield _judge_room(patient, needed, free, available)
    kind = patient.machine.filesystem_of(directory)
    if kind not in {"tmpfs", "ramfs", "hugetlbfs", None}:
        yield warning(
            f"{directory} is on {kind}, not in memory: frames would wait for a disk.",
            "Set [ring] directory to /dev/shm.",
        )


def _judge_room(patient: Patient, needed: int, free: int, available: int | None) -> Finding:
    layout, directory = patient.layout, patient.config.ring.directory
    figures: Figures = {"ring_bytes": needed, "free_bytes": free, "available_bytes": available}
    told = (
        f"the ring needs {shown_bytes(needed)} ({layout.bays} runs × {layout.cameras} cameras × "
        f"{layout.slots_per_camera} rows × {shown_bytes(layout.slot_bytes)})"
    )
    if free < needed:
        room = f"mount -o remount,size={round(needed * 1.1 / 2**20) + 1}M {directory}"
        return fault(f"{told}, {directory} has {shown_bytes(free)}.", f"{room}; or: {_SMALLER}.", figures=figures)
    if available is not None and available < needed:
        return fault(
            f"{told}, the machine has {shown_bytes(available)} of memory left.", f"{_SMALLER}.", figures=figures
        )
    if available is not None and available < 1.5 * needed:
        left = shown_bytes(available - needed)
        return warning(f"{told}; only {left} are left for everything else.", f"{_SMALLER}.", figures=figures)
    return ok(f"{told}, {directory} has {shown_bytes(free)}", figures=figures)


def lock_limit(patient: Patient) -> Iterator[Finding]:
    """Is the ring locked in memory, if the station runs; may this user's programs lock one, if not?"""
    needed = patient.layout.file_bytes
    if patient.running is not None and patient.running.pid is None:
        yield not_applicable(f"{patient.running.who} has the ring, and does not show whether it is locked")
    elif patient.running is not None and patient.running.pid is not None:
        yield judge_locked(patient.machine.locked_bytes(patient.running.pid), needed, patient.running.pid)
    elif patient.machine.may_lock_anything():
        yield ok("this user may lock as much as it wants (CAP_IPC_LOCK)")
    else:
        yield judge_lock(resource.getrlimit(resource.RLIMIT_MEMLOCK)[0], needed)


def judge_locked(locked: int | None, needed: int, pid: int) -> Finding:
    """What a running station has locked."""
    figures: Figures = {"locked_bytes": locked, "ring_bytes": needed}
    if locked is not None and locked >= needed:
        return ok(f"process {pid} has locked its ring, {shown_bytes(locked)}", figures=figures)
    return warning(f"process {pid} has not locked its ring: short of memory, frames are late.", _LOCK, figures=figures)


def judge_lock(limit: int, needed: int) -> Finding:
    """RLIMIT_MEMLOCK of this user."""
    figures: Figures = {"limit_bytes": limit, "ring_bytes": needed}
    if limit == resource.RLIM_INFINITY:
        return ok("this user may lock as much as it wants", figures=figures)
    if limit >= needed:
        return ok(f"this user may lock {shown_bytes(limit)}", figures=figures)
    return warning(
        f"this user may lock {shown_bytes(limit)} of {shown_bytes(needed)}: short of memory, frames are late.",
        _LOCK,
        figures=figures,
    )
