"""One calculated quantity with the limit that it must keep, and the limits in the firmware's source."""

from __future__ import annotations

import operator
import re
from dataclasses import dataclass
from pathlib import Path

LIMITS = Path(__file__).parents[1] / "firmware" / "logic" / "pulses" / "limits.h"
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
_RELATIONS = {"≤": operator.le, "≥": operator.ge}


@dataclass(frozen=True)
class Figure:
    """One calculated quantity. `relation` and `limit` are empty if the quantity has no limit."""

    name: str
    formula: str
    value: float
    unit: str
    relation: str = ""
    limit: float = 0.0
    why: str = ""

    @property
    def ok(self) -> bool:
        """Whether the quantity keeps its limit."""
        return not self.relation or bool(_RELATIONS[self.relation](self.value, self.limit))


@dataclass(frozen=True)
class Firmware:
    """The limits of pulses that the firmware enforces, from `limits.h`."""

    longest_s: tuple[float, ...]
    """Longest pulse per channel."""
    duty: float

    @classmethod
    def read(cls, path: Path = LIMITS) -> Firmware:
        """Read the limits from the source file that the compiler reads."""
        text = path.read_text(encoding="utf-8")
        longest = re.search(r"#define LED_LONGEST \{([^}]*)\}", text)
        shift = re.search(r"#define LED_DUTY_SHIFT (\d+)", text)
        assert longest is not None, f"{path} has no LED_LONGEST"
        assert shift is not None, f"{path} has no LED_DUTY_SHIFT"
        return cls(tuple(int(us) * 1e-6 for us in re.findall(r"US\((\d+)\)", longest[1])), 0.5 ** int(shift[1]))


def shown(value: float, unit: str) -> str:
    """Format a value with three digits and a unit prefix: 0.00183 A becomes 1.83 mA."""
    if unit == "" and abs(value) < 1:
        return f"{100 * value:.3g} %"
    if unit in {"", "°C", "Hz", "K"} or value == 0:
        return f"{value:.3g} {unit}".strip() if value < 1000 else f"{value:.0f} {unit}"
    scale, prefix = next(((s, p) for s, p in _PREFIXES if abs(value) >= s * 0.9995), _PREFIXES[-1])
    return f"{value / scale:.3g} {prefix}{unit}"


def row(figure: Figure) -> tuple[str, str, str, str]:
    """Return the cells of a table row: name, formula, value, limit."""
    limit = f"{figure.relation} {shown(figure.limit, figure.unit)}" if figure.relation else ""
    return figure.name, figure.formula, shown(figure.value, figure.unit), f"{limit} {figure.why}".strip()
