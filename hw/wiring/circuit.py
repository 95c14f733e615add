"""Read the circuit from `circuit.toml`: parts, pins and nets. Check the rules that every circuit must follow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from vaoi_station.files.documents import parse, read_toml

SOURCE = Path(__file__).with_name("circuit.toml")
OPEN = "-"
SUPPLIES = frozenset({"24V", "24V_IN", "24V_SENSOR", "5V", "5V_USB"})
GROUNDS = frozenset({"0V", "0V_USB", "PE"})


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Part(_Strict):
    """One part of the circuit, drawn as one box. The box may stand for `count` equal parts."""

    ref: str
    what: str
    column: int
    left: tuple[tuple[str, str], ...] = ()
    """Pins and their nets, from top to bottom."""
    right: tuple[tuple[str, str], ...] = ()
    count: int = 1
    value: float | None = None
    unit: str = ""
    watt: float | None = None

    @property
    def pins(self) -> tuple[tuple[str, str], ...]:
        """All pins of the part, each with the name of its net."""
        return self.left + self.right


class Sheet(_Strict):
    """One drawing of the circuit."""

    name: str
    title: str
    port: str = ""
    copies: tuple[str, ...] = ()
    """A sheet built several times: the net `port` is another one in each copy, all other nets are the copy's own."""
    barrier: str = ""
    """Reference of the part through which the galvanic isolation runs."""
    parts: tuple[Part, ...]

    @property
    def built(self) -> int:
        """The number of times that the circuit of this drawing is built."""
        return max(1, len(self.copies))

    def net(self, name: str, copy: int) -> str:
        """Return the name, in the whole circuit, of a net of this drawing.

        A drawing that is built several times has one such net per `copy`.
        """
        if not self.copies or name in SUPPLIES | GROUNDS:
            return name
        return self.copies[copy] if name == self.port else f"{name} ({self.name} {copy})"


@dataclass(frozen=True)
class Pin:
    """One pin of one part, to which a net is connected."""

    sheet: str
    ref: str
    name: str


class Circuit(_Strict):
    """The whole circuit: its drawings, and the values from data sheets with which the calculations start."""

    design: dict[str, Any]
    sheets: tuple[Sheet, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _sound(self) -> Circuit:
        refs = [part.ref for sheet in self.sheets for part in sheet.parts]
        if twins := sorted({ref for ref in refs if refs.count(ref) > 1}):
            raise ValueError(f"parts {twins} appear twice")
        for net, pins in self.nets.items():
            if len(pins) < 2:
                raise ValueError(f"net {net!r} has one end only, {pins[0].ref} {pins[0].name}")
        return self

    @cached_property
    def nets(self) -> dict[str, list[Pin]]:
        """Each net by its name, with the pins that it connects."""
        nets: dict[str, list[Pin]] = {}
        for sheet in self.sheets:
            for copy in range(sheet.built):
                for part in sheet.parts:
                    for name, net in part.pins:
                        if net != OPEN:
                            nets.setdefault(sheet.net(net, copy), []).append(Pin(sheet.name, part.ref, name))
        return nets

    def part(self, ref: str) -> Part:
        """Return a part by its reference, such as R22. A box of several parts has the first reference of its label."""
        for sheet in self.sheets:
            for part in sheet.parts:
                if part.ref == ref or part.ref.startswith((f"{ref}…", f"{ref},")):
                    return part
        raise KeyError(ref)

    def value(self, ref: str) -> float:
        """Return the value of a part in Ω, F, A or V."""
        value = self.part(ref).value
        if value is None:
            raise KeyError(f"{ref} has no value")
        return value


def read_circuit(path: Path = SOURCE) -> Circuit:
    """Read `circuit.toml` and check the circuit.

    Raises:
        InputError: the circuit breaks a rule; the message names the rule and the part.
    """
    return parse(Circuit, read_toml(path), path)
