"""Run an import in its own process, within limits of memory and time."""

from __future__ import annotations

import logging
import subprocess
import sys

from vaoi_station.board_data.import_process import ImportLimits, ImportReply, ImportTask
from vaoi_station.child_environment import child_environment
from vaoi_station.errors import InputError

_log = logging.getLogger(__name__)


def import_limited(task: ImportTask, limits: ImportLimits | None = None) -> ImportReply:
    """Import a file in a process of its own.

    Raises:
        InputError: the file is refused, or exceeds a limit.
    """
    limits = limits or ImportLimits()
    # One thread of BLAS: each reserves address space, of which the process has little.
    environment = child_environment(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    command = [sys.executable, "-P", "-m", "vaoi_station.board_data.import_process"]
    text = f"{limits.model_dump_json()}\n{task.model_dump_json()}\n"
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            out, errors = process.communicate(text, timeout=limits.wall_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise InputError(
                f"{task.file}: cannot be read within {limits.wall_s:g} s; the file is refused.",
                action=limits.advice,
            ) from None
    if process.returncode != 0:
        _log.info("import of %s ended with code %d: %s", task.file, process.returncode, errors[-2000:])
        raise InputError(
            f"{task.file}: cannot be read within {limits.cpu_s} s of computing time and {limits.memory_bytes >> 20} MB "
            "of memory; the file is refused.",
            action=limits.advice,
        )
    if errors:
        _log.info("import of %s: %s", task.file, errors[-2000:])
    reply = ImportReply.model_validate_json(out)
    if reply.refusal:
        raise InputError(reply.refusal, action=reply.action)
    return reply
