"""Exit codes and error sentences of the command line."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest

from tests.cli.conftest import Result
from vaoi_station import __version__
from vaoi_station.errors import DeviceError, InputError, InternalError, NotFoundError, StateError
from vaoi_station.runs.host.logs import STREAM_VARIABLE


def test_version_is_printed(vaoi: Callable[..., Result]) -> None:
    assert vaoi("--version").out == f"vaoi_station {__version__}\n"


def test_help_names_every_command(vaoi: Callable[..., Result]) -> None:
    text = vaoi("--help").out
    for command in ("plan", "simulate", "serve", "record", "calibrate", "calibration-board", "recalibrate", "stitch",
                    "report", "teach", "cut", "bench", "demo", "doctor", "rig"):  # fmt: skip
        assert command in text


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (InputError("f.json: rows is 0.", action="Correct it."), 2, "vaoi: f.json: rows is 0. Correct it.\n"),
        (NotFoundError("f.json: there is no such file."), 2, "vaoi: f.json: there is no such file.\n"),
        (DeviceError("camera 0: is lost."), 3, "vaoi: camera 0: is lost.\n"),
        (StateError("the line is armed."), 3, "vaoi: the line is armed.\n"),
        (InternalError("the task failed."), 4, "vaoi: the task failed.\n"),
        (OSError(13, "Permission denied", "/data"), 2, "vaoi: /data: Permission denied.\n"),
        # systemd starts the service again after code 3, because room may come back
        (OSError(28, "No space left on device", "/data"), 3, "vaoi: /data: No space left on device.\n"),
    ],
)
def test_errors_are_one_sentence_with_an_exit_code(
    vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, error: Exception, code: int, sentence: str
) -> None:
    fail_with(monkeypatch, error)
    done = vaoi("stitch", "case", "--out", "out.json")
    assert (done.code, done.out, done.err) == (code, "", sentence)


def test_traceback_is_shown_on_request(vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VAOI_TRACEBACK", "1")
    fail_with(monkeypatch, ZeroDivisionError("division by zero"))
    with pytest.raises(ZeroDivisionError):
        vaoi("stitch", "case", "--out", "out.json")


def test_a_refusal_has_the_priority_of_an_error_in_the_journal(
    vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`journalctl -p warning` shows why the service has ended."""
    stream = os.fstat(2)
    monkeypatch.setenv(STREAM_VARIABLE, f"{stream.st_dev}:{stream.st_ino}")
    fail_with(monkeypatch, InputError("file: no such file.\nSecond line."))
    done = vaoi("stitch", "case", "--out", "out.json")
    assert done.code == 2
    assert done.err == "<3>vaoi: file: no such file.\n<3>Second line.\n"


def fail_with(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """Make `vaoi stitch` raise an error when it opens its recording."""

    def raise_it(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("vaoi_station.stitching.recordings.opening.open_run", raise_it)
