"""Watch of the lamps: lights under which successive boards are darker than the first boards of their type.

The brightness of a camera, light and exposure is divided by its baseline, the median of the first runs of the board
type. A light is dim if this share is too low in several runs of a type in a row, and no longer after some that are not.
Only boards of one type are compared, at the same places, so the darkness of a board or its parts has no influence.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.checks import LampBaseline, LampCheck, RunCheck
from vaoi_station.drift.lamps import SAME_EXPOSURE, is_comparable

BASELINE_RUNS = 5
"""Number of first runs of a board type that are its baseline."""
DIM_SHARE = 0.9
"""Share of the baseline's brightness below which a light is dim, if another light or camera is brighter as well."""
DARK_BOARD_SHARE = 0.8
"""The same if all lights are dim in all cameras alike: boards of another lot may be darker by less than this."""
DARK_SHARE = 0.3
"""Share below which a single run suffices: an LED that is unplugged does not age."""
DIM_RUNS, BRIGHT_RUNS = 3, 2
"""Numbers of successive runs after which a light counts as dim, and as bright again."""
_SCATTERS = 3.0
"""A dim run is darker than the median of the baseline by at least this multiple of the baseline's scatter."""
_LEAST_SHOWN = 0.5
"""A run is compared if it has at least this share of the samples of the baseline: the board is as much in view."""
_RECENT_RUNS = 50
"""A light that none of this number of latest runs shows, because the program has changed, is not reported."""

Key = tuple[int, str, str]
"""A camera, the name of a light, and a board type: types differ in scatter, so one may show what another does not."""


@dataclass(frozen=True)
class DimLamp:
    """A light under which the boards have become dark."""

    light: str
    """Name of the light; an empty text if the lights have no names."""
    cameras: tuple[int, ...]
    """Cameras whose pictures are dark under this light."""
    share: float
    """Brightness relative to the baseline: median over these cameras and the runs since."""
    since_run: str
    since_time: str
    runs: int
    """Number of runs, since the light is dim, that show it."""
    everywhere: bool
    """Whether, of the board types that show it, all lights are dim in all cameras: the boards may be darker instead."""


def find_dim_lamps(checks: Sequence[RunCheck]) -> tuple[DimLamp, ...]:
    """Find the lights that are dim at the end of a sequence of runs, sorted by name.

    Args:
        checks: checks of runs under one calibration, `with_baselines`, oldest first.
    """
    series = {key: runs for key, runs in _shares(checks).items() if runs[-1].run >= len(checks) - _RECENT_RUNS}
    dim = {key: since for key, runs in series.items() if (since := _dim_since(runs)) is not None}
    types = {board_type for *_, board_type in dim}
    everywhere = all(key in dim for key in series if key[2] in types)
    found: list[DimLamp] = []
    for light in sorted({light for _, light, _ in dim}):
        keys = [key for key in sorted(dim) if key[1] == light]
        shown = [s for key in keys for s in series[key][dim[key] :]]
        cameras, runs = tuple(sorted({camera for camera, *_ in keys})), {s.run for s in shown}
        first, share = checks[min(runs)], float(np.median([s.share for s in shown]))
        found.append(DimLamp(light, cameras, share, first.run, first.time, len(runs), everywhere))
    return tuple(found)


@dataclass(frozen=True)
class _Share:
    run: int
    """Index of the run."""
    share: float
    """Brightness relative to the baseline."""
    dim: bool


def with_baselines(check: RunCheck, earlier: Sequence[RunCheck]) -> RunCheck:
    """Return a check whose lamps have baselines, as far as earlier runs under the same calibration give them.

    `earlier` begins with the oldest.
    """
    kept: dict[tuple[int, str], list[LampCheck]] = defaultdict(list)
    for other in earlier:
        if other.board_type == check.board_type:
            for lamp in other.lamps:
                kept[lamp.camera, lamp.light].append(lamp)
    lamps = tuple(
        lamp.model_copy(update={"baseline": _baseline(lamp, kept[lamp.camera, lamp.light])}) for lamp in check.lamps
    )
    return check.model_copy(update={"lamps": lamps})


def only_baselines(check: RunCheck, before: RunCheck | None) -> RunCheck:
    """Return a check with only those lamps that have baselines, and those of `before` that the check does not show.

    It has nothing of the cameras, because it is kept for each board type. `before` is what this function returned for
    the run before of the same board type; None for its first run.
    """
    lamps = [lamp for lamp in check.lamps if lamp.baseline is not None]
    shown = {(lamp.camera, lamp.light) for lamp in lamps}
    lamps += [lamp for lamp in (before.lamps if before else ()) if (lamp.camera, lamp.light) not in shown]
    return check.model_copy(
        update={"lamps": tuple(lamps), "cameras": (), "rivals": (), "information": (), "vector": ()}
    )


def _baseline(lamp: LampCheck, earlier: Sequence[LampCheck]) -> LampBaseline | None:
    """Return the baseline of the earlier runs at this exposure, or the one of their first runs; None if they are too
    few."""
    alike = [e for e in earlier if abs(math.log(e.exposure / lamp.exposure)) <= SAME_EXPOSURE]
    known = next((e.baseline for e in reversed(alike) if e.baseline is not None), None)
    # Darkness and saturation are no baseline.
    first = [e for e in alike if is_comparable(e)][:BASELINE_RUNS]
    if known is not None or len(first) < BASELINE_RUNS:
        return known
    brightness = np.array([e.grey / e.exposure for e in first])
    middle = float(np.median(brightness))
    # The largest deviation may be that of one odd board, which says nothing about the others.
    scatter = float(np.sort(np.abs(np.log(brightness / middle)))[-2])
    grey, points = (float(np.median(values)) for values in zip(*((e.grey, e.points) for e in first), strict=True))
    return LampBaseline(brightness=middle, scatter=scatter, grey=grey, points=points)


def _shares(checks: Sequence[RunCheck]) -> dict[Key, list[_Share]]:
    """Return for every camera, light and board type the comparisons with the baseline, in the order of the runs."""
    series: dict[Key, list[_Share]] = defaultdict(list)
    for k, check in enumerate(checks):
        best: dict[Key, tuple[LampBaseline, float]] = {}
        for lamp in check.lamps:
            key, baseline = (lamp.camera, lamp.light, check.board_type), lamp.baseline
            if baseline is None or lamp.points < _LEAST_SHOWN * baseline.points:
                continue
            # Of several exposures, the one with the largest grey levels is the least disturbed by the dark level.
            if key not in best or baseline.grey > best[key][0].grey:
                best[key] = baseline, lamp.grey / lamp.exposure / baseline.brightness
        # What all lights lose alike may be the board's: another lot of solder mask.
        brightest = min(max((share for _, share in best.values()), default=0.0), 1.0)
        for key, (baseline, share) in best.items():
            # A baseline of boards that differ much must not hide an LED that is unplugged.
            limit = max(math.exp(-_SCATTERS * baseline.scatter), DARK_SHARE)
            dim = share < min(DIM_SHARE, limit) * brightest or share < min(DARK_BOARD_SHARE, limit)
            series[key].append(_Share(k, share, dim))
    return series


def _dim_since(runs: Sequence[_Share]) -> int | None:
    """Return the index, in `runs`, of the first run since which a light is dim; None if it is not dim at the end."""
    since: int | None = None
    dim = bright = 0
    for k, run in enumerate(runs):
        dim, bright = (dim + 1, 0) if run.dim else (0, bright + 1)
        if since is None and (dim == DIM_RUNS or (run.dim and run.share < DARK_SHARE)):
            since = k - dim + 1
        elif bright == BRIGHT_RUNS:
            since = None
    return since
