"""Check the files that the configuration names."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from vaoi_station.acquisition.controller.filming_plan import filming_plan
from vaoi_station.acquisition.process.backends import check_backends
from vaoi_station.api.certificate import CertificateFiles, valid_until
from vaoi_station.config import StationConfig
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.machine import is_directory, writable
from vaoi_station.doctor.machine_checks import CONNECT_S
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.errors import DeviceError, InputError, VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.files.documents import read_text
from vaoi_station.model import BoardType
from vaoi_station.model.receivers import BrokerConfig
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.flat_fields import EXPIRED_DAYS
from vaoi_station.push import proton_library
from vaoi_station.store import BoardTypeDirectory


def calibration(context: CheckContext) -> Iterator[Finding]:
    """Check that the calibration can be read and fits the configured cameras."""
    path = context.config.calibration
    try:
        read = read_calibration(path, [c.head for c in context.config.cameras])
    except VaoiError as error:
        first = (
            "With the station stopped: vaoi record --config station.toml --out board-film --still; "
            "vaoi calibrate board-film: docs/how-to/calibration.md"
        )
        yield fault("calibration-unusable", error.message, error.action or first, path=str(path))
        return
    made = f", made {read.created}" if read.created else ""
    yield ok(f"{path}: {len(read.camera_matrices)} cameras{made}")


def board_types(context: CheckContext) -> Iterator[Finding]:
    """Check that each board type can be read, and that new board types can be stored."""
    directory = context.config.board_types
    if not is_directory(directory):
        yield fault(
            "board-types-absent",
            f"there is no directory {directory}, or this user cannot see it.",
            f"install -d -o $USER {directory}",
            path=str(directory),
        )
        return
    files = BoardTypeDirectory(directory).list()
    for file in files:
        if file.fault is not None:
            action = file.fault.action or "Correct the file; docs/formats.md describes it."
            yield fault("board-type-unreadable", file.fault.message, action, file.path.name)
    sound = [file.board_type.name for file in files if file.board_type is not None]
    if not files:
        yield warning(
            "board-types-empty",
            f"{directory} is empty: the station cannot be armed without a board type.",
            "Put a board type there, NAME.json: docs/formats.md.",
            path=str(directory),
        )
    elif not writable(directory):
        yield warning(
            "board-types-read-only",
            f"{directory} cannot be written to: board types cannot be stored by REST.",
            f"chown vaoi {directory}",
            path=str(directory),
        )
    elif sound:
        types = "1 board type" if len(sound) == 1 else f"{len(sound)} board types"
        yield ok(f"{directory}: {types} can be read", board_types=len(sound))


def flat_fields(context: CheckContext) -> Iterator[Finding]:
    """Check that the flat fields fit the cameras and the lights of station and board types, and are not too old."""
    config = context.config
    again = "Film a white target and darkness, then vaoi flatfield: docs/how-to/photometry.md."
    if config.flat_fields is None:
        yield not_applicable("no flat_fields are configured")
        return
    try:
        fields = FlatFields.peek(config.flat_fields)
        heads = [camera.head for camera in config.cameras]
        fields.check(heads, config.known_lights or fields.named_lights)
    except VaoiError as error:
        yield fault("flat-fields-unusable", error.message, error.action or again, path=str(config.flat_fields))
        return
    for board_type in _sound_board_types(config):
        if board_type.program:
            try:
                fields.check(heads, [step.light for step in board_type.program])
            except VaoiError as error:
                yield warning(
                    "flat-fields-lack-program",
                    f"board type {board_type.name!r}: {error.message}",
                    error.action or again,
                    board_type=board_type.name,
                )
    days = fields.age_days(datetime.now(UTC))
    if days is not None and days > EXPIRED_DAYS:
        yield warning(
            "flat-fields-old",
            f"{config.flat_fields}: the flat fields are {days:.0f} days old and expire after {EXPIRED_DAYS}: lamps "
            "age, and dust settles on lenses.",
            again,
            days=round(days),
        )
        return
    age = "" if days is None else f", {days:.0f} days old"
    yield ok(f"{config.flat_fields}: {len(config.cameras)} cameras{age}")


def _sound_board_types(config: StationConfig) -> list[BoardType]:
    if not is_directory(config.board_types):
        return []
    listed = BoardTypeDirectory(config.board_types).list()
    return [file.board_type for file in listed if file.board_type is not None]


def programs(context: CheckContext) -> Iterator[Finding]:
    """Check that light program, belt speed and lengths of the station and of each board type fit the station."""
    config = context.config
    px_per_mm: list[float] = []
    heads = tuple(camera.head for camera in config.cameras)
    with contextlib.suppress(VaoiError):  # the check of the calibration reports it
        px_per_mm = [camera.px_per_mm for camera in read_calibration(config.calibration, heads).cameras(heads)]
    sound = _sound_board_types(config)
    own = [board_type for board_type in sound if board_type.program or board_type.line]
    wrong = False
    for board_type in (None, *own):
        try:
            filming_plan(config, board_type, px_per_mm)
        except InputError as error:
            wrong = True
            action = error.action or "Correct it; docs/how-to/light.md describes programs and their limits."
            yield fault("program-unusable", error.message, action, "station" if board_type is None else board_type.name)
    if not wrong:
        station = f"{len(config.program)} steps in station.toml" if config.program else "none in station.toml"
        yield ok(f"{station}, {len(own)} of {len(sound)} board types with a program or a line of their own")


def stand_ins(context: CheckContext) -> Iterator[Finding]:
    """Check the inputs of a station that simulates or replays its devices: the scenario, or the recordings."""
    backend = context.config.controller.backend
    if backend not in {"simulated", "replay"}:
        yield not_applicable("cameras and controller are real")
        return
    try:
        check_backends(context.config)
    except VaoiError as error:
        yield fault(
            "stand-in-unusable",
            error.message,
            error.action or "Correct the tables [simulation] or [replay] of station.toml.",
        )
        return
    yield ok(
        "the scenario fits the configuration" if backend == "simulated" else "the recordings fit the configuration"
    )


_OTHERS = 0o007


def readable_by_others(path: Path, what: str, subject: str) -> Iterator[Finding]:
    """Warn of a file with a secret that every user of the machine can read."""
    if path.stat().st_mode & _OTHERS:
        yield warning(
            "secret-not-private",
            f"{what} in {path} can be read by every user.",
            f"chmod o= {path}",
            subject,
            path=str(path),
        )


EARLY = timedelta(days=30)


def station_certificate(context: CheckContext) -> Iterator[Finding]:
    """Check that certificate and private key fit each other, who may read the key, and how long both are valid."""
    api = context.config.api
    if api.certificate is None or api.private_key is None:
        yield not_applicable("no certificate is configured: the station speaks HTTP without TLS")
        return
    try:
        CertificateFiles(api.certificate, api.private_key)
        end = valid_until(api.certificate)
    except InputError as error:
        yield fault("certificate-unusable", error.message, error.action)
        return
    yield from readable_by_others(api.private_key, "the private key of the station", "")
    if end is None:
        yield ok(f"{api.certificate} and its private key fit each other", path=str(api.certificate))
        return
    left = end - datetime.now(UTC)
    date = f"{end:%Y-%m-%d %H:%M} UTC"
    figures: Figures = {"path": str(api.certificate), "days": left.days}
    if left < EARLY:
        yield warning(
            "certificate-expires",
            f"{api.certificate} is valid until {date} only: callers refuse it then.",
            "Replace certificate and private key; the station reads them again without a restart.",
            **figures,
        )
    else:
        yield ok(f"{api.certificate} is valid until {date}", **figures)


def receivers(context: CheckContext) -> Iterator[Finding]:
    """Check the brokers of station.toml, to which nothing is sent. The station films without them."""
    push = context.config.push
    brokers: dict[str, BrokerConfig] = {
        key: broker for key, broker in (("mqtt", push.mqtt), ("cfx", push.cfx)) if broker is not None
    }
    if not brokers:
        yield not_applicable("no broker is configured")
    for key, broker in brokers.items():
        problems = [*_broker(key, broker), *_reached(key, broker)]
        yield from problems
        if not problems:
            yield ok(f"the {key.upper()} broker {broker.host} can be used")


def neighbours(context: CheckContext) -> Iterator[Finding]:
    """Check that each product of the line has a board type."""
    hermes = context.config.hermes
    if hermes is None:
        yield not_applicable("station.toml has no neighbours that speak Hermes")
        return
    known = {file.board_type.name for file in BoardTypeDirectory(context.config.board_types).list() if file.board_type}
    wrong = [f"{product} ({name})" for product, name in hermes.products.items() if name not in known]
    if wrong:
        message = f"hermes.products: the board types of {', '.join(wrong)} do not exist or cannot be read."
        yield warning("product-unusable", message, "Store the board types, or correct the names.", "products")
    else:
        yield ok(f"the board types of {len(hermes.products)} products of the line can be read")


def _reached(key: str, broker: BrokerConfig) -> Iterator[Finding]:
    try:
        socket.create_connection(broker.place, CONNECT_S).close()
    except OSError as error:
        message = f"push.{key}: {broker.host}:{broker.place[1]} is not reached: {error.strerror or error}."
        action = "Check the broker, its address and the network; the station tries again by itself."
        if key == "mqtt":
            yield warning("mqtt-lost", message, action, key)
        else:
            yield warning("cfx-lost", message, action, key)


def _library(key: str, broker: BrokerConfig) -> Iterator[Finding]:
    if key == "mqtt" and importlib.util.find_spec("paho") is None:
        message = f"push.mqtt: {broker.host} is configured, but the package paho-mqtt is absent."
        yield warning("mqtt-package-absent", message, "pip install 'vaoi-station[mqtt]'", key)
    if key == "cfx":
        try:
            proton_library.load()
        except DeviceError as error:
            yield fault("cfx-package-absent", error.message, error.action, key)


def _broker(key: str, broker: BrokerConfig) -> Iterator[Finding]:
    yield from _library(key, broker)
    if broker.password_file is not None:
        figures: Figures = {"path": str(broker.password_file)}
        message, action = f"push.{key}.password_file: {broker.password_file} is empty.", "Write the password."
        try:
            unusable = not read_text(broker.password_file).strip()
        except VaoiError as error:
            unusable, message = True, f"push.{key}.password_file: {error.message}"
            action = error.action or "Write the password to it, and make it readable to the service."
        if unusable:
            if key == "mqtt":
                yield warning("mqtt-password-unusable", message, action, key, **figures)
            else:
                yield warning("cfx-password-unusable", message, action, key, **figures)
        if broker.password_file.is_file():
            yield from readable_by_others(broker.password_file, f"push.{key}: the password", key)
    if broker.ca is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(broker.ca)
        except OSError as error:
            message = f"push.{key}.ca: {broker.ca} cannot be read as PEM certificates ({error})."
            figures = {"path": str(broker.ca)}
            yield warning("certificate-unusable", message, "Give a PEM file.", key, **figures)
    if broker.certificate is not None and broker.private_key is not None:
        try:
            # Without a password here, an encrypted key would be asked for at the terminal.
            ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(broker.certificate, broker.private_key, lambda: "")
        except (OSError, ValueError) as error:
            message = f"push.{key}: {broker.certificate} and {broker.private_key} cannot be used ({error})."
            action = "Give a certificate and its private key as PEM files without a password."
            yield warning("certificate-unusable", message, action, key)
