"""Tables of the finds of the hostile suite, and the finds that are kept as regressions."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tests.hostile.drawing import FORM
from tests.hostile.judging import CLASSES, OK_AND_WRONG, Outcome
from tests.hostile.mistakes import EVERY_KIND

KEPT = Path(__file__).with_name("finds.json")
"""Finds of earlier runs: seed, classes, diagnosis, and whether the cause is mended."""
_MOST_SEEDS = 12
_TAIL, _HALVINGS = 0.025, 60
"""Probability on either side of a 95 % interval, and halvings of the range in which its end is searched."""


def kept_finds() -> list[dict[str, Any]]:
    """Return the finds that are kept for this form of the generator."""
    document = json.loads(KEPT.read_text(encoding="utf-8"))
    return list(document["finds"]) if document["form"] == FORM else []


def open_classes(seed: int) -> set[str]:
    """Return the classes in which the drawing of a seed is a known find whose cause is not mended yet."""
    return {name for find in kept_finds() if find["seed"] == seed and not find["mended"] for name in find["classes"]}


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the finds by class as a table in Markdown: number, rate, and seeds."""
    expected, ok = sum(o.expected for o in outcomes), sum(o.status == "ok" for o in outcomes)
    lines = ["| class | finds | of | rate (95 % interval) | seeds |", "|---|---|---|---|---|"]
    for name, sentence in CLASSES.items():
        seeds = [o.seed for o in outcomes if name in o.finds]
        of = {"refused": expected, "exception": len(outcomes)}.get(name, ok)
        named = ", ".join(map(str, seeds[:_MOST_SEEDS])) + (", …" if len(seeds) > _MOST_SEEDS else "")
        low, high = interval(len(seeds), of)
        rate = f"{len(seeds) / max(of, 1):.1%} ({100 * low:.1f} … {100 * high:.1f})"
        lines.append(f"| {name}: {sentence} | {len(seeds)} | {of} | {rate} | {named} |")
    return "\n".join(lines)


def interval(count: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate that is seen `count` times in `of` (Clopper and Pearson); 0 to 1 for none."""
    low = 0.0 if not count else _where_reached(lambda p: _at_least(count, of, p))
    high = 1.0 if count == of else _where_reached(lambda p: 1 - _at_least(count + 1, of, p), falling=True)
    return low, high


def _at_least(count: int, of: int, rate: float) -> float:
    """Return the probability of `count` or more of `of` at a rate."""
    return 1 - sum(math.comb(of, k) * rate**k * (1 - rate) ** (of - k) for k in range(count))


def _where_reached(probability: Callable[[float], float], *, falling: bool = False) -> float:
    """Return the rate at which a probability, which rises or falls with the rate, is 2.5 %."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if (probability(middle) < _TAIL) != falling:
            low = middle
        else:
            high = middle
    return low


def table_of_mistakes(outcomes: Sequence[Outcome]) -> str:
    """Return a table in Markdown: for each mistake the drawings that have it, their verdicts, and their finds."""
    lines = ["| mistake | drawings | ok | degraded | failed | finds that are `ok` and wrong | refused |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for name in ("", *sorted(EVERY_KIND)):
        have = [o for o in outcomes if (name in {m.split()[0] for m in o.mistakes} if name else not o.mistakes)]
        counts = [sum(o.status == status for o in have) for status in ("ok", "degraded", "failed")]
        wrong = [o.seed for o in have if set(o.finds) & set(OK_AND_WRONG)]
        refused = [o.seed for o in have if "refused" in o.finds]
        cells = [name or "none", len(have), *counts, ", ".join(map(str, wrong)), ", ".join(map(str, refused))]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def table_of_reasons(outcomes: Sequence[Outcome]) -> str:
    """Return a table in Markdown: how often each check fires, and what it decides where no other check fires.

    A check that catches nothing alone, but is alone on right boards, costs alarms for nothing.
    """
    lines = ["| reason | fires | alone, positions wrong | alone, positions right | of these, expected to be `ok` |"]
    lines += ["|---|---|---|---|---|"]
    every = Counter(code for o in outcomes for code in set(o.codes))
    for code, count in every.most_common():
        alone = [o for o in outcomes if o.status == "degraded" and set(o.codes) == {code}]
        right = [o for o in alone if not o.wrong]
        cells = [f"`{code}`", count, len(alone) - len(right), len(right), sum(o.expected for o in right)]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def line(o: Outcome) -> str:
    """Return one line about an outcome, to show progress and finds."""
    figures = f"{o.rms_px:.3f} px rms, σ {o.sigma_px:.3f}, worst {o.worst_px:.2f} px, {o.worst_sigma:.1f} σ"
    expected = "expected ok" if o.expected else f"not expected ({'; '.join(o.impossible)})"
    finds, mistakes = ",".join(o.finds) or "-", ", ".join(o.mistakes) or "no mistake"
    return f"{o.seed:6d} {o.status:9s} {figures}; {expected}; {mistakes}; {finds}"
