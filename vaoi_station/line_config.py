"""The tables of `station.toml` on the line: geometry, speed and timing, and where boards are expected."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from vaoi_station.model import Finite, Positive, Whole

ENCODER_RESERVE = 1.25
"""Fastest speed of a belt with an encoder, as a multiple of its nominal speed, unless station.toml states it."""
MOST_COUNTS = 1 << 30
"""Largest distance in counts of the encoder that the controller's firmware takes (hw/protocol.md)."""
ENCODER_LATENCY_S = 1e-3
"""Time from the count at which a row is due to its pulse (hw/protocol.md)."""
MOST_COUNTS_PER_S = 12_000
"""Fastest encoder, counts/s: four per period of 3 kHz, which the filters of the inputs let pass (hw/wiring.md)."""

NotNegative = Annotated[Finite, Field(ge=0)]


class Section(BaseModel):
    """Base class of the tables in the file: immutable; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ExpectedBoard(Section):
    """Position of the board when the first row is filmed, with tolerances.

    The leading edge follows from barrier, delay and speed. Across the line, a fixed rail or the middle of the
    conveyor guides the board.
    """

    rail_mm: Finite | None = None
    """Tester coordinate, across the motion, of the board's lower edge at the fixed rail."""
    center_mm: Finite | None = None
    """Tester coordinate of the board's middle, on lines that centre boards."""
    rotation_deg: Literal[0, 90, 180, 270] = 0
    """Rotation of the board on the belt, counter-clockwise from CAD-upright as the camera sees it."""
    tolerance_mm: Positive = 4.0
    """Largest distance of the board from its expected place."""
    rotation_tolerance_deg: Annotated[Positive, Field(le=30)] = 3.0
    """Largest rotation of the board against the expected one."""

    @model_validator(mode="after")
    def _one_guide(self) -> Self:
        if self.rail_mm is not None and self.center_mm is not None:
            raise ValueError("rail_mm and center_mm exclude each other; give the one that guides the board")
        return self


class Encoder(Section):
    """The encoder on the belt, and the speed up to which rows may follow it."""

    counts_per_mm: Positive
    """Counts of the controller per mm of the belt: four per period of an encoder with two channels."""
    row_mm: Positive | None = None
    """Distance of the belt between two rows; it may replace `trigger_period_s` of the line."""
    fastest_mm_s: Positive | None = None
    """Fastest speed of the belt that cameras and LEDs must be able to follow; None: 1.25 times the nominal speed."""


class EncoderPlaces(NamedTuple):
    """Distances of a run in counts of the encoder."""

    start: int
    """From the edge of the barrier to row 0."""
    row: int
    """Between two rows."""
    tail: int
    """From the end of the board to the last place at which a row is fired."""


class Line(Section):
    """The geometry and the timing of the line: speed, barrier, distances."""

    conveyor_mm_s: tuple[Finite, Finite]
    """Nominal velocity of the board in tester coordinates."""
    barrier_mm: Finite
    """Tester coordinate, along the motion, of the light barrier."""
    start_delay_s: NotNegative
    """Time from the interruption of the barrier to the first pulse."""
    trigger_period_s: Positive
    """Time between two pulses; longer than every exposure."""
    tail_s: NotNegative
    """Time for which pulses continue after the board has left the barrier."""
    transport_s: tuple[NotNegative, Positive] = (0.0, 30.0)
    """Shortest and longest time from the start of a board's transport, as the neighbour's messages state it, to the
    barrier."""
    longest_board_mm: Positive
    """Longest board, along the motion; it determines the size of the ring."""
    carrier_mm: Positive | None = None
    """Length along the motion of the carrier in which boards ride; None if the barrier sees the boards themselves."""
    debounce_s: NotNegative = 0.005
    """Shorter interruptions of the barrier are ignored as bounces."""
    max_blur_px: Positive = 3.0
    """Longest motion of a picture, px, while a row of a light program is lit."""
    pacing: Literal["time", "encoder"] = "time"
    """What spaces the rows: the controller's clock, or the belt's way as the encoder counts it. Then start delay,
    period and tail stand for the distances that the belt covers in them at its nominal speed."""
    encoder: Encoder | None = None
    speed_limits_mm_s: tuple[Positive, Positive] | None = None
    """Slowest and fastest speed of the belt that a board type may state; None: only that of `conveyor_mm_s`."""
    rail_limits_mm: tuple[Finite, Finite] | None = None
    """Lowest and highest place of the rail that a board type may state; None: only that of `expected_board`."""
    expected_board: ExpectedBoard = ExpectedBoard()

    @model_validator(mode="before")
    @classmethod
    def _period_of_row(cls, data: Any) -> Any:
        """Fill in the period at the nominal speed where the distance of the rows is given instead."""
        encoder = data.get("encoder") if isinstance(data, dict) else None
        row_mm = encoder.get("row_mm") if isinstance(encoder, dict) else getattr(encoder, "row_mm", None)
        velocity = data.get("conveyor_mm_s") if row_mm is not None else None
        try:
            speed_mm_s = math.hypot(*velocity) if velocity is not None else 0.0
            period_s = float(row_mm) / speed_mm_s if row_mm is not None and speed_mm_s else None
        except (TypeError, ValueError):
            return data  # the fields themselves are refused
        if period_s is None:
            return data
        given_s = data.get("trigger_period_s", period_s)
        if isinstance(given_s, int | float) and not math.isclose(given_s, period_s, rel_tol=1e-6):
            raise ValueError(
                f"trigger_period_s is {given_s}, but encoder.row_mm {row_mm} is {period_s:.6g} s at {speed_mm_s:g} "
                "mm/s; give one of the two"
            )
        return {**data, "trigger_period_s": given_s}

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.speed_mm_s == 0:
            raise ValueError("conveyor_mm_s is [0, 0], but must not be zero")
        if fault := self.encoder_fault():
            raise ValueError(fault)
        for key in ("speed_limits_mm_s", "rail_limits_mm", "transport_s"):
            limits = getattr(self, key)
            if limits is not None and limits[0] > limits[1]:
                raise ValueError(f"{key} is {list(limits)}, but must begin with the lower limit")
        # The controller would end such a run before its first pulse.
        if self.start_delay_s > self.passing_s:
            raise ValueError(
                f"start_delay_s is {self.start_delay_s}, but the longest board has passed the barrier and "
                f"the tail is over after {self.passing_s:.3f} s"
            )
        return self

    @property
    def speed_mm_s(self) -> float:
        """The speed of the belt (the paper's v)."""
        return math.hypot(*self.conveyor_mm_s)

    @property
    def by_encoder(self) -> bool:
        """Whether the belt's way spaces the rows."""
        return self.pacing == "encoder"

    @property
    def fastest_mm_s(self) -> float:
        """The fastest speed at which rows are filmed: the nominal one, or that which the encoder may report."""
        if not self.by_encoder or self.encoder is None:
            return self.speed_mm_s
        return self.encoder.fastest_mm_s or ENCODER_RESERVE * self.speed_mm_s

    @property
    def shortest_period_s(self) -> float:
        """Shortest time between two rows that cameras, network and LEDs must be able to follow."""
        return self.trigger_period_s * self.speed_mm_s / self.fastest_mm_s

    def counts(self, nominal_s: float) -> int:
        """Return the counts of the encoder for the distance that the belt covers in a time at its nominal speed."""
        assert self.encoder is not None
        return round(nominal_s * self.speed_mm_s * self.encoder.counts_per_mm)

    @property
    def encoder_places(self) -> EncoderPlaces:
        """The distances of the rows in counts of the encoder, as the controller gets them."""
        # A row is fired ENCODER_LATENCY_S after its count. At the nominal speed it then lies at its place; at another
        # speed v it lies (v − nominal) · ENCODER_LATENCY_S beyond it.
        lead = self.counts(ENCODER_LATENCY_S)
        start, row, tail = (self.counts(s) for s in (self.start_delay_s, self.trigger_period_s, self.tail_s))
        return EncoderPlaces(max(0, start - lead), row, max(0, tail - lead))

    def row_ways_mm(self, rows: int) -> tuple[float, ...] | None:
        """Return the belt's way at each row since row 0 by the encoder; None if the clock spaces the rows."""
        if not self.by_encoder or self.encoder is None:
            return None
        return row_ways_mm(self.counts(self.trigger_period_s) / self.encoder.counts_per_mm, rows)

    def encoder_fault(self) -> str:
        """Return why rows cannot follow the encoder; an empty text if they can, or if the clock spaces them."""
        if not self.by_encoder:
            return ""
        if self.encoder is None:
            return 'pacing is "encoder", but there is no table [line.encoder] with counts_per_mm'
        per_mm, row_mm = self.encoder.counts_per_mm, self.trigger_period_s * self.speed_mm_s
        if not 1 <= self.counts(self.trigger_period_s) <= MOST_COUNTS:
            counts = row_mm * per_mm
            return (
                f"encoder.counts_per_mm is {per_mm:g}: rows lie {row_mm:g} mm, {counts:g} counts, apart, but must be "
                f"1 … {MOST_COUNTS}"
            )
        if self.fastest_mm_s < self.speed_mm_s:
            fastest = f"encoder.fastest_mm_s is {self.fastest_mm_s:g}"
            return f"{fastest}, but must be at least the speed of the belt, {self.speed_mm_s:g}"
        if (rate := per_mm * self.fastest_mm_s) > MOST_COUNTS_PER_S:
            return (
                f"encoder.counts_per_mm is {per_mm:g}: {rate:.0f} counts/s at {self.fastest_mm_s:g} mm/s, but must be "
                f"at most {MOST_COUNTS_PER_S} counts/s, the limit of the controller's inputs"
            )
        return ""

    @property
    def passing_s(self) -> float:
        """The time from the moment the longest board interrupts the barrier to the end of the tail time, in s."""
        return self.longest_board_mm / self.speed_mm_s + self.tail_s

    @property
    def rows_of_longest_board(self) -> int:
        """Number of pulses for the longest board, from start delay to end of tail (the paper's m)."""
        if self.by_encoder and self.encoder is not None:
            # The controller gets whole counts, so that its rows lie closer than the period says, or further apart.
            start, row, tail = self.encoder_places
            board = math.ceil(round(self.longest_board_mm * self.encoder.counts_per_mm, 6))
            return 1 + max(0, math.ceil((board + tail - start) / row))
        return 1 + math.ceil((self.passing_s - self.start_delay_s) / self.trigger_period_s)


def row_ways_mm(row_mm: float, rows: int) -> tuple[float, ...]:
    """Return the belt's way at each row since row 0, for rows at equal distances, rounded to nm."""
    return tuple(round(row * row_mm, 6) for row in range(rows))


HERMES_PORT = 50_100
"""Port of IPC-HERMES-9852 to which the number of the lane is added."""
HermesAddress = Annotated[str, Field(pattern=r"^[A-Za-z0-9.-]{1,253}(:[0-9]{1,5})?$")]
"""Name or address, and if it is another than 50100 plus the lane, the port."""


class Hermes(Section):
    """The neighbours in the line that speak IPC-HERMES-9852 (docs/line.md)."""

    lane: Annotated[Whole, Field(ge=1, le=99)] = 1
    """Number of the lane; ports are 50100 plus this number unless they are given."""
    upstream: HermesAddress | None = None
    """The machine from which boards come: the station connects to it; None: it does not speak Hermes."""
    listen: HermesAddress | None = None
    """Address of this machine at which the next machine connects; None: it does not speak Hermes."""
    supervisor: HermesAddress | None = None
    """Address of this machine at which a supervisory system connects; None: there is none. The port must be given."""
    tap: bool = False
    """Whether the station only reads along between two other machines (`vaoi_station.hermes.tap`)."""
    machine: Annotated[str, Field(min_length=1, max_length=80)] | None = None
    """Name of the station in messages; None: `name`."""
    places: Annotated[Whole, Field(ge=1, le=20)] = 1
    """Number of boards that may stand between the barrier and the next machine."""
    transfer_s: Annotated[Positive, Field(le=3600)] | None = None
    """Longest time from StartTransport to TransportFinished of the machine upstream; None: as for the way to the
    barrier, the second value of `line.transport_s`."""
    exit_s: Annotated[Positive, Field(le=3600)] = 5.0
    """Time from the StartTransport of the next machine until a board has left the station."""
    products: dict[str, str] = {}
    """Board type for each ProductTypeId of the line."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.tap and (self.upstream or self.listen):
            raise ValueError("tap excludes upstream and listen: a station that only reads along talks to none")
        if not self.tap and not (self.upstream or self.listen):
            raise ValueError("upstream, listen or tap is missing; give the neighbours that speak Hermes")
        if self.supervisor is not None and ":" not in self.supervisor:
            raise ValueError(f"supervisor is {self.supervisor!r}, but must end with a port, as in 0.0.0.0:50200")
        for key in ("upstream", "listen", "supervisor"):
            if (given := getattr(self, key)) is not None and not 1 <= self.address(given)[1] <= 65_535:
                raise ValueError(f"{key} is {given!r}, but its port must be from 1 to 65535")
        if self.upstream and self.listen and self.address(self.upstream) == self.address(self.listen):
            raise ValueError(f"upstream and listen are both {self.upstream!r}: the station would be its own neighbour")
        return self

    def longest_transfer_s(self, line: Line) -> float:
        """Return the longest time of a transport from upstream."""
        return line.transport_s[1] if self.transfer_s is None else self.transfer_s

    def address(self, given: str) -> tuple[str, int]:
        """Return host and port of an address as it is given in the table."""
        host, _, port = given.partition(":")
        return host, int(port) if port else HERMES_PORT + self.lane


class Smema(Section):
    """The neighbours in the line by the contacts of IPC-SMEMA-9851 on the controller (docs/line.md)."""

    sides: Literal["upstream", "both"]
    """Whether only the contacts of the machine upstream are wired, or those of the next machine as well."""
    exit_s: tuple[NotNegative, Annotated[Positive, Field(le=60)]] = (1.0, 30.0)
    """Shortest and longest time in which a board leaves for a next machine that is ready."""
    places: Annotated[Whole, Field(ge=1, le=20)] = 1
    """Number of boards that may stand between the barrier and the next machine."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.exit_s[0] > self.exit_s[1]:
            raise ValueError(f"exit_s is {list(self.exit_s)}, but must begin with the lower limit")
        return self
