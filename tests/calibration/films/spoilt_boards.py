"""Ninety films of the twin's calibration board with hidden, dirty and scratched marks, and their score.

`python -m tests.calibration.films.spoilt_boards` runs all of them; `test_spoilt_boards.py` runs a part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration import Limits, Outcome, calibrate
from vaoi_station.files.calibrations import Layout
from vaoi_station.simulation import Twin, calibration_board
from vaoi_station.simulation.scenario import ArraySection, CalibrationBoardSection, Scenario

Frame = NDArray[np.uint8]
Spoil = Callable[[Frame, np.random.Generator], None]
GRIDS, SEEDS = (3, 5, 7), (1, 2, 3)
_BOARD, _INK = 205, 25


def _strip(frame: Frame, g: np.random.Generator, grey: int) -> None:
    """Hide a strip at one side of the frame."""
    share = g.uniform(0.1, 0.4)
    view = np.rot90(frame, int(g.integers(4)))
    view[:, : round(share * view.shape[1])] = grey


def dark_strip(frame: Frame, g: np.random.Generator) -> None:
    _strip(frame, g, int(g.integers(0, 60)))


def pale_strip(frame: Frame, g: np.random.Generator) -> None:
    _strip(frame, g, _BOARD)


def frame_of_tape(frame: Frame, g: np.random.Generator) -> None:
    """Hide the rim on all four sides."""
    grey = int(g.choice([30, 120, 235]))
    for _ in range(4):
        frame = np.rot90(frame)
        frame[:, : round(g.uniform(0.12, 0.3) * frame.shape[1])] = grey


def finger(frame: Frame, g: np.random.Generator) -> None:
    h, w = frame.shape
    tip = g.uniform((0.2 * w, 0.2 * h), (0.8 * w, 0.8 * h))
    root = tip + 2 * w * np.array([np.cos(t := g.uniform(0, 2 * np.pi)), np.sin(t)])
    points = [tuple(int(v) for v in np.round(p)) for p in (tip, root)]
    cv2.line(frame, points[0], points[1], 120, int(0.2 * w), cv2.LINE_AA)


def six_scratches(frame: Frame, g: np.random.Generator) -> None:
    h, w = frame.shape
    for _ in range(6):
        a, b = (tuple(int(v) for v in g.uniform((-0.1 * w, -0.1 * h), (1.1 * w, 1.1 * h))) for _ in range(2))
        cv2.line(frame, a, b, int(g.choice([30, 120, 250])), int(g.integers(3, max(w // 60, 4))), cv2.LINE_AA)


def long_scratches(frame: Frame, g: np.random.Generator) -> None:
    """Scratch along rows or columns near the rim, which hides a whole line of marks."""
    view = np.rot90(frame, int(g.integers(2)))
    w = view.shape[1]
    for share in (0.2, 0.8):
        x = int((share + g.uniform(-0.02, 0.02)) * w)
        view[:, x - w // 60 : x + w // 60] = int(g.choice([30, 250]))


def blots(frame: Frame, g: np.random.Generator) -> None:
    h, w = frame.shape
    for _ in range(40):
        x, y = (int(v) for v in g.uniform((0, 0), (w, h)))
        cv2.circle(frame, (x, y), int(g.integers(3, w // 40)), int(g.choice([25, 90, 205])), -1, cv2.LINE_AA)


def grease(frame: Frame, g: np.random.Generator) -> None:
    """Dim and blur patches with soft edges."""
    h, w = frame.shape
    for _ in range(6):
        mask = np.zeros(frame.shape, np.float32)
        x, y = (int(v) for v in g.uniform((0, 0), (w, h)))
        cv2.circle(mask, (x, y), int(g.integers(w // 20, w // 8)), 1.0, -1)
        mask = cv2.GaussianBlur(mask, (0, 0), w / 80)
        dull = cv2.GaussianBlur(frame, (0, 0), w / 300).astype(np.float32) * 0.7 + 40
        frame[:] = np.clip(np.rint(frame * (1 - mask) + dull * mask), 0, 255).astype(np.uint8)


def pale_labels(frame: Frame, g: np.random.Generator) -> None:
    """Lay labels of the board's colour over parts of the pattern."""
    h, w = frame.shape
    for _ in range(3):
        x, y = (int(v) for v in g.uniform((0, 0), (0.8 * w, 0.8 * h)))
        frame[y : y + int(g.uniform(0.1, 0.3) * h), x : x + int(g.uniform(0.1, 0.35) * w)] = _BOARD


def false_crosses(frame: Frame, g: np.random.Generator) -> None:
    """Add crosses of the right size at wrong places, and hide one side."""
    h, w = frame.shape
    size = w // 17
    for _ in range(6):
        x, y = (int(v) for v in g.uniform((size, size), (w - size, h - size)))
        frame[y - size // 8 : y + size // 8, x - size // 2 : x + size // 2] = _INK
        frame[y - size // 2 : y + size // 2, x - size // 8 : x + size // 8] = _INK
    _strip(frame, g, 40)


SPOILS: tuple[Spoil, ...] = (
    dark_strip,
    pale_strip,
    frame_of_tape,
    finger,
    six_scratches,
    long_scratches,
    blots,
    grease,
    pale_labels,
    false_crosses,
)


@dataclass(frozen=True)
class Variant:
    """One spoilt film: a plain grid of `grid`² marks per camera, the kind of damage, and its seed."""

    grid: int
    spoil: Spoil
    seed: int

    @property
    def name(self) -> str:
        return f"{self.spoil.__name__}-{self.grid}x{self.grid}-{self.seed}"

    @property
    def twin(self) -> Twin:
        return _film(self.grid, self.seed)[0]

    def calibrate(self, **limits: Any) -> Outcome:
        """Calibrate from the film; all cameras or only the first one are spoilt, by the seed."""
        twin, layout, frames = _film(self.grid, self.seed)
        g = np.random.default_rng([self.seed, self.grid, SPOILS.index(self.spoil)])
        spoilt = range(len(frames)) if g.random() < 0.5 else range(1)

        def frame(camera: int) -> Frame:
            picture = frames[camera].copy()
            if camera in spoilt:
                self.spoil(picture, np.random.default_rng([self.seed, self.grid, camera]))
                noise = np.random.default_rng(camera).normal(0, 1.5, picture.shape)
                changed = picture != frames[camera]
                picture[changed] = np.clip(picture + noise, 0, 255).astype(np.uint8)[changed]
            return picture

        return calibrate(twin.heads, frame, layout, Limits(**limits))


def variants() -> Iterator[Variant]:
    """Yield all ninety variants."""
    for spoil in SPOILS:
        for grid in GRIDS:
            for seed in SEEDS:
                yield Variant(grid, spoil, seed)


def corner_errors(twin: Twin, outcome: Outcome) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the real errors (n, 4) at the corners of all frames, px, and their standard deviations as stated."""
    errors, sigmas = [], []
    cameras = outcome.calibration().cameras(twin.heads)
    for result, camera, pinhole in zip(outcome.cameras, cameras, twin.pinholes, strict=True):
        w, h = camera.width_px - 1.0, camera.height_px - 1.0
        corners = np.array([[0, 0], [w, 0], [0, h], [w, h]])
        errors.append(np.hypot(*(pinhole.project(camera.ground(corners), 0.0) - corners).T))
        assert result.fit is not None
        sigmas.append(result.fit.sigma_at_px(corners))
    return np.array(errors), np.array(sigmas)


@lru_cache(maxsize=9)
def _film(grid: int, seed: int) -> tuple[Twin, Layout, tuple[Frame, ...]]:
    """Film the clean board with small frames; lenses differ by the seed."""
    bent = float(np.random.default_rng(seed).normal(0, 0.75))
    array = ArraySection(cameras=2, width_px=696, height_px=520, px_per_mm=20.0, distortion_px=bent, seed=10 + seed)
    twin = Twin(Scenario(array=array, calibration_board=CalibrationBoardSection(marks_per_axis=grid)))
    frames = tuple(frame for _, _, frame in calibration_board.frames(twin))
    return twin, Layout.model_validate(calibration_board.layout(twin)), frames


def main() -> None:
    """Print one line per variant, and the figures of all."""
    refused, wrong, ratios = 0, 0, []
    for variant in variants():
        outcome = variant.calibrate()
        if outcome.refused:
            refused += 1
            print(f"{variant.name:28s} refused: {outcome.error().message[:110]}")
            continue
        errors, sigmas = corner_errors(variant.twin, outcome)
        wrong += bool(errors.max() > 5)
        ratios.append((errors / sigmas).ravel())
        print(
            f"{variant.name:28s} worst {errors.max():7.3f} px, stated {sigmas.max():.3f} px, "
            f"ratio {ratios[-1].max():.2f}"
        )
    every = np.concatenate(ratios)
    print(
        f"{len(ratios)} calibrated, {refused} refused, {wrong} off by a spacing; error / sigma of corners: "
        f"rms {np.sqrt((every**2).mean()):.2f}, median {np.median(every):.2f}, beyond 3: {(every > 3).mean():.1%}"
    )


if __name__ == "__main__":
    main()
