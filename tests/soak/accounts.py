"""Whether every run is accounted for: filmed = announced with a verdict, or named as lost with a reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import httpx2


@dataclass(frozen=True)
class Accounts:
    """The runs of a soak, from three sources: announcements, the list of runs, and the event log."""

    announced: int
    listed: int
    verdicts: Mapping[str, int]
    reasons: Mapping[str, int]
    """Number of runs by the code of each of their reasons."""
    missed: int
    """Boards that passed without a run, as the station has counted and published them."""
    finds: tuple[str, ...]
    """What contradicts: runs that were announced and are not on disk, that have no end, or no reason."""

    def document(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def list_runs(client: httpx2.Client) -> dict[str, dict[str, Any]]:
    """Return all runs of the station by their ids, oldest first."""
    found: list[dict[str, Any]] = []
    query: dict[str, Any] = {"limit": 500}
    while True:
        page = client.get("/runs", params=query).raise_for_status().json()
        found += page["runs"]
        if not page.get("next"):
            return {run["id"]: run for run in reversed(found)}
        query["before"] = page["next"]


def account(
    announced: Mapping[str, str],
    listed: Mapping[str, Mapping[str, Any]],
    events: Sequence[Mapping[str, Any]],
    kept: int = 1000,
) -> Accounts:
    """Compare what was announced with what is kept and with the event log.

    Args:
        announced: run → verdict that was announced ("" without one).
        listed: run → its summary in the list of runs.
        events: the event log.
        kept: number of newest runs of which at least the summary must be kept ([keep] runs).
    """
    oldest = min(sorted(announced)[-kept:], default="~")
    finds = [
        f"{run}: announced as {v!r}, not listed" for run, v in announced.items() if run >= oldest and run not in listed
    ]
    for run, shown in listed.items():
        verdict = shown.get("verdict") or ""
        if run not in announced:
            finds.append(f"{run}: listed as {shown['state']} {verdict!r}, never announced")
        elif announced[run] and announced[run] != verdict:
            finds.append(f"{run}: announced as {announced[run]!r}, listed as {verdict!r}")
        # A run that a start has found under way has no result and thus no time of it, but a reason.
        if not shown.get("finished") and shown["state"] != "gone":
            finds.append(f"{run}: {shown['state']}, has not ended")
        if verdict != "ok" and not shown["reasons"]:
            finds.append(f"{run}: {shown['state']} {verdict!r} without a reason")
        if not shown.get("stored", True):
            finds.append(f"{run}: is not on disk")
    begun = [e["run"] for e in events if e["kind"] == "run" and e["state"] == "filming"]
    filmed = {run for run in begun if not announced or run >= oldest}
    finds += [f"{run}: filmed, neither listed nor announced" for run in sorted(filmed - set(listed) - set(announced))]
    numbers = [e["number"] for e in events]
    if numbers and numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        finds.append("events: the numbers have gaps")
    return Accounts(
        announced=len(announced),
        listed=len(listed),
        verdicts=dict(Counter(str(v or "none") for v in announced.values())),
        reasons=dict(Counter(r["code"] for shown in listed.values() for r in shown["reasons"])),
        missed=sum(e["kind"] == "board-missed" for e in events),
        finds=tuple(finds),
    )
