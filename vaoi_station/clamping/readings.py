"""Judge a tester's readings of fiducials, and fit the board to them: the whole, boards of a panel, local fiducials."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.clamping import documents as doc
from vaoi_station.clamping.bending import TILT_MM, Bending, bent, level
from vaoi_station.clamping.filmed import FilmedBoard
from vaoi_station.clamping.fit import FREE, SCALE, SHEAR, STRETCH, TURN, Fit, fit, left_out, refined
from vaoi_station.clamping.wrong_fiducials import Assignment, Ints, assignments
from vaoi_station.errors import InputError, VaoiError
from vaoi_station.geometry.robust import Failure, fit_similarity
from vaoi_station.geometry.transforms import Floats, Similarity, System, apply
from vaoi_station.model import Reason
from vaoi_station.model.frozen_model import MOST_MM

_BOW_MM, _THICKNESS_MM = 0.2, 1.6
_SIGMAS, _SHAPE_SIGMAS = 5.0, 3.0
"""A reading is doubted from the first distance on, a change of shape named from the second on."""
_TURN_RAD = math.radians(10.0)
"""How far the turn may be from the stated one."""
_OWN = np.array([0.1, 0.1, 1e-3, 5e-5, 5e-5, 5e-5])
"""Standard deviations of how boards of a panel, and places of local fiducials, move against the rest: mm, rad, 1."""
_MOST_STRAIN = 1e-2
"""Standard deviation of the shape once readings have shown that it is none of those that the tester states."""
_SHAPE = {SCALE: "scale", STRETCH: "stretch (x longer, y shorter)", SHEAR: "shear"}


def _check_lengths(request: doc.ClampedRequest) -> None:
    """Raise InputError if a length is none of a board, which most probably is of another unit."""
    mm, most = doc.MM_PER_UNIT[request.unit], {"sigma": 10.0, "sigma_z": 10.0, "bow": 20.0, "thickness": 20.0}
    stated = [(key, getattr(of, key)) for of in (request, *request.readings) for key in most if hasattr(of, key)]
    for key, value in stated:
        if value is not None and not 1e-6 <= value * mm <= most[key]:
            raise InputError.field("request", key, value, f"1e-06 to {most[key]:g} mm; unit is {request.unit}")
    for reading in request.readings:
        far = max(abs(reading.x), abs(reading.y), abs(reading.z or 0.0))
        if far * mm > MOST_MM:
            limit = f"within ±{MOST_MM:g} mm; unit is {request.unit}"
            raise InputError.field("request", f"the reading of {reading.fiducial}", far, limit)


class MisfitError(VaoiError):
    """Readings that place no board."""


@dataclass(eq=False)
class Readings:
    """The readings in mm, the places as filmed, and what was found about them."""

    film: FilmedBoard
    request: doc.ClampedRequest

    def __post_init__(self) -> None:
        r, mm = self.request.readings, doc.MM_PER_UNIT[self.request.unit]
        names = [reading.fiducial for reading in r]
        known = self.film.numbers
        if unknown := [name for name in names if name not in known]:
            limit = f"one of the fiducials of the board type: {', '.join(list(known)[:12])}"
            raise InputError.field("request", "readings.fiducial", unknown[0], limit)
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise InputError.field("request", "readings.fiducial", twice[0], "read once", "Send the mean of readings.")
        _check_lengths(self.request)
        self.mm, self.names, self.of = mm, names, np.array([known[name] for name in names])
        self.at = mm * np.array([(reading.x, reading.y) for reading in r])
        own = mm * np.array([self.request.sigma if reading.sigma is None else reading.sigma for reading in r])
        self.place, self.sigma = self.film.places[self.of], np.hypot(own, self.film.sigma_mm[self.of])
        self.with_z = [n for n, reading in enumerate(r) if reading.z is not None]
        stated = [r[n].sigma_z or self.request.sigma_z for n in self.with_z]
        if None in stated:
            raise InputError.field("request", "sigma_z", None, "stated, as readings have z")
        self.z, self.sigma_z = np.array([mm * (r[n].z or 0.0) for n in self.with_z]), mm * np.array(stated, np.float64)
        c, board = self.film.matrix(None), self.film.board_type
        # As the filmed side is seen, CAD coordinates are right-handed exactly if an image mirrors them.
        self.mirrored = (board.mirrors != (self.request.y_axis == "up")) != bool(np.linalg.det(c[:2, :2]) < 0)
        self.cad_angle = math.atan2(c[1, 0], c[0, 0]) * (-1 if self.mirrored else 1)
        """Angle of the CAD x axis in the tester's coordinates if these are those of the film, turned by 0."""
        self.bow = mm * self.request.bow if self.request.bow else _BOW_MM
        self.thickness = mm * self.request.thickness if self.request.thickness else _THICKNESS_MM
        # A bow moves the surface by half the thickness times its slope, which stretches x and y.
        x, y = self.thickness * self.bow / (self.film.half[1] * board.mm_per_unit) ** 2
        bent = np.array([math.hypot(x, y) / 2, math.hypot(x, y) / 2, math.sqrt(x * y) / 2])
        scale, shear = 1e-6 * self.request.scale_ppm, 1e-6 * self.request.shear_ppm
        self.prior = np.r_[FREE, FREE, FREE, np.hypot([scale, shear, shear], bent)]
        self.reasons, self.remarks, self.left_out = list[Reason](), list[str](), set[int]()

    def add_reason(self, code: str, message: str, action: str) -> None:
        """Add a reason why the answer is not `ok`."""
        self.reasons.append(Reason(code, message, action))

    def turned_by(self, turn_rad: float) -> float:
        """Return by how much a turn of the film differs from the one that the tester states, rad; 0 if none."""
        if self.request.turn_deg is None:
            return 0.0
        off = turn_rad + self.cad_angle - math.radians(self.request.turn_deg)
        return math.remainder(off, math.tau)

    def assigned(self) -> list[int]:
        """Return the readings that are of the fiducials that they name. Raise `MisfitError` if too few are."""
        ppm, count = 1e6 * float(self.prior[3:].max()), len(self.of)
        if count == 1 and self.request.turn_deg is None:
            message = f"one reading shows where {self.names[0]} is, not how the board is turned"
            raise MisfitError(message, action="Read a second fiducial, or state turn_deg.", code="turn-not-known")
        if count == 1:
            return [0]
        film = self.film.places
        best, others = assignments(film, self.at, self.of, self.sigma, ppm, mirrored=self.mirrored)
        turned = self.turned_by(best.turn_rad) if best.explained else 0.0
        wrong = abs(turned) > _TURN_RAD
        likely = [a for a in others if abs(self.turned_by(a.turn_rad)) <= _TURN_RAD]
        few = best.explained < 3 or 2 * best.explained <= count
        if likely and (wrong or (few and likely[0].explained > best.explained)):
            swaps = self._other_names(likely[0])
            message = f"{likely[0].explained} of {count} readings fit if {swaps}: they name other fiducials"
            raise MisfitError(
                message, action="Check names, and which way round the board lies.", code="fiducials-exchanged"
            )
        if wrong:
            message = f"the board lies turned by {math.degrees(turned):.1f}° against turn_deg"
            raise MisfitError(message, action="Check which way round it lies, and the value.", code="board-turned")
        if best.explained < min(count, 3) or 2 * best.explained <= count:
            raise self._misfit(best, ppm)
        for n in np.flatnonzero(best.of < 0).tolist():
            self._leave_out(n, self._meant(n, best))
        if alike := [a for a in likely if a.explained == best.explained]:
            message = f"the readings fit as well if {self._other_names(alike[0])}"
            turns = [abs(math.remainder(a.turn_rad - best.turn_rad, math.tau)) for a in alike]
            if self.request.turn_deg is None and max(turns) > 0.1:
                message = f"the readings fit as well if {self._other_names(alike[turns.index(max(turns))])}"
                action = "State turn_deg, or read a fiducial off their symmetry."
                raise MisfitError(message, action=action, code="orientation-not-shown")
            self.remarks.append(message)
        return np.flatnonzero(best.of >= 0).tolist()

    def _other_names(self, a: Assignment) -> str:
        known = self.film.board_type.fiducials
        swaps = [
            f"{self.names[n]} is {known[m].name}" for n, m in enumerate(a.of.tolist()) if m not in (-1, self.of[n])
        ]
        return ", ".join(swaps[:6])

    def _meant(self, n: int, best: Assignment) -> str:
        """Return what a reading that does not fit may be of."""
        good = np.flatnonzero(best.of >= 0)
        rigid = self._rigid(good)
        off = np.hypot(*(apply(rigid, self.film.places) - self.at[n]).T)
        own, near = float(off[self.of[n]]), int(off.argmin())
        if off[near] < 0.1:
            return f"it is at the place of {self.film.board_type.fiducials[near].name}"
        return f"it is {own / self.mm:.4g} {self.request.unit} from where the others expect it"

    def _misfit(self, best: Assignment, ppm: float) -> MisfitError:
        """Return why the readings do not fit: another unit, the mirror image, or another board."""
        unit, of = self.request.unit, (self.of, self.sigma, ppm)
        read, filmed = (np.abs(p[:, None] @ (1, 1j) - p @ (1, 1j)) for p in (self.at, self.place))
        i, j = divmod(int(filmed.argmax()), len(filmed))
        factor = float(read[i, j]) / max(float(filmed[i, j]), 1e-9)
        for other, mm in doc.MM_PER_UNIT.items():
            if other != unit and abs(factor * mm / self.mm - 1) < 0.01:
                message = f"distances are {factor:.4g} times those filmed: {other} read as {unit}?"
                return MisfitError(message, action=f"Check unit, which is {unit}.", code="readings-other-unit")
        flipped, _ = assignments(self.film.places, self.at, *of, mirrored=not self.mirrored)
        if flipped.explained > max(best.explained, 2):
            message = f"{flipped.explained} of {len(self.of)} readings fit the mirror image of the board"
            return MisfitError(
                message, action="Check y_axis, the side that is up, and the run.", code="readings-mirrored"
            )
        i, j = divmod(int(np.abs(read - filmed).argmax()), len(filmed))
        a, b = self.names[i], self.names[j]
        message = (
            f"the readings are not of this board: {a} and {b} are {read[i, j] / self.mm:.6g} {unit} apart, filmed "
            f"{filmed[i, j] / self.mm:.6g} {unit}"
        )
        return MisfitError(
            message, action="Check names and run, and read the fiducials again.", code="readings-disagree"
        )

    def _rigid(self, used: Sequence[int] | Ints) -> Floats:
        """Return the rigid motion (3, 3) that fits readings best; for a single one with the turn that is stated."""
        turn, known = 0.0, list(used)
        if len(known) == 1:
            turn = math.radians(self.request.turn_deg or 0.0) - self.cad_angle
        else:
            pairs = self.at[known], self.place[known]
            similar = fit_similarity(*pairs, System.TESTER, System.ROW, mirrored=self.mirrored)
            if isinstance(similar, Failure):
                raise MisfitError(similar.reason, action="Read fiducials that are apart.", code="readings-disagree")
            turn = similar.angle_rad
        rigid = Similarity.of(1.0, turn, (0, 0), System.TESTER, System.ROW, mirrored=self.mirrored).matrix.copy()
        rigid[:2, 2] = (self.at[known] - apply(rigid, self.place[known])).mean(0)
        return rigid

    def fitted(self, used: list[int]) -> tuple[Fit, list[int]]:
        """Return the transform of the whole board and the readings that have a part in it.

        Boards of a panel, and components with local fiducials, move against the rest: theirs take no part if others do.
        """
        apart = self.film.board_type.apart_from_c(self.of[used].tolist())
        whole = [n for n in used if int(self.of[n]) not in apart]
        used = whole if len(whole) > 1 else list(used)
        found, worst = self._fit(used)
        if len(used) == 2 and self._turn_checked:
            self._check_turn(found)
        if worst is not None and len(used) > 3:
            # One wrong reading explains a misfit better than a change of shape, if the others then agree.
            others = [n for n in used if n != worst[0]]
            again, next_worst = self._fit(others)
            if next_worst is None and not again.exceeded(_SHAPE_SIGMAS):
                self._leave_out(*worst)
                return again, others
        if changed := found.exceeded(_SHAPE_SIGMAS):
            found, worst = self._fit(used, changed)
        while worst is not None and len(used) > 3:
            self._leave_out(*worst)
            used.remove(worst[0])
            found, worst = self._fit(used, changed)
        if worst is not None:
            message = f"the reading of {self.names[worst[0]]} disagrees: {worst[1]}"
            raise MisfitError(message, action="Read these fiducials again, or one more.", code="readings-disagree")
        if changed:
            if len(used) <= 3:
                # One wrong reading explains it as well.
                found.covariance[changed, changed] += found.values[changed] ** 2
            shown = ", ".join(
                f"{_SHAPE[n]} {1e6 * found.values[n]:+.0f} ppm (expected {1e6 * self.prior[n]:.0f})" for n in changed
            )
            action = "Check the readings, the tester's calibration, the temperature of the board, and its clamping."
            self.add_reason("shape-changed", f"the board as clamped differs from the one filmed: {shown}", action)
        return found, used

    @property
    def _turn_checked(self) -> bool:
        return self.request.turn_deg is not None and "turn_sigma_deg" in self.request.model_fields_set

    def _check_turn(self, found: Fit) -> None:
        """Raise `MisfitError` if two readings show another turn than the one that is stated, with its σ."""
        turn = math.atan2(found.matrix[1, 0], found.matrix[0, 0])
        # A shear turns the x axis too.
        own = found.covariance[np.ix_((TURN, SHEAR), (TURN, SHEAR))].sum()
        off, sigma = math.degrees(abs(self.turned_by(turn))), math.degrees(math.sqrt(own))
        sigma = math.hypot(sigma, self.request.turn_sigma_deg)
        if off > _SIGMAS * sigma:
            message = f"two readings show a turn {off:.3g}° off turn_deg ({off / sigma:.1f} σ): one is off their line"
            raise MisfitError(message, action="Read both again, or a third fiducial.", code="board-turned")

    def _fit(self, used: list[int], changed: Sequence[int] = ()) -> tuple[Fit, tuple[int, str] | None]:
        """Return the transform by some readings, and the one that is farthest from what the others expect, if too far.

        The parameters of shape that have `changed` are free.
        """
        prior, own = self.prior.copy(), (self.place[used], self.at[used], self.sigma[used])
        prior[list(changed)] = _MOST_STRAIN
        if len(used) == 1:
            prior[TURN] = math.radians(self.request.turn_sigma_deg)
        found = fit(self._rigid(used), *own, prior)
        off, sigmas = left_out(found, *own)
        worst = int(np.nan_to_num(sigmas).argmax())
        far = f"{np.hypot(*off[worst]) / self.mm:.4g} {self.request.unit} ({sigmas[worst]:.1f} σ)"
        return found, (used[worst], f"it is {far} off") if sigmas[worst] > _SIGMAS else None

    def _leave_out(self, n: int, why: str) -> None:
        self.left_out.add(n)
        self.add_reason(
            "reading-wrong", f"the reading of {self.names[n]} is left out: {why}", "Read this fiducial again."
        )

    def regions(self, whole: Fit, named: list[int]) -> dict[tuple[str, ...], tuple[Fit, list[int]]]:
        """Return the transforms of boards of a panel, and of components with local fiducials, by their own readings.

        The key of a board is ("board", position), that of components ("parts", address, …).
        """
        board, own = self.film.board_type, dict[tuple[str, ...], list[int]]()
        for n in named:
            if n in self.left_out:
                continue
            mark = board.fiducials[self.of[n]]
            if int(self.of[n]) in board.local_fiducials:
                own.setdefault(("parts", *(mark.components or ())), []).append(n)
            elif mark.panel is not None:
                own.setdefault(("board", str(mark.panel)), []).append(n)
        return {key: (self._region(whole, at), at) for key, at in own.items()}

    def _region(self, whole: Fit, at: list[int]) -> Fit:
        # The whole, against which it has moved, is itself known to its own errors there.
        known = np.r_[whole.variance(self.at[at].mean(0)[None])[0], whole.covariance.diagonal()[2:]]
        return refined(whole, self.place[at], self.at[at], self.sigma[at], np.sqrt(_OWN**2 + known))

    def heights(self, used: list[int]) -> Bending:
        """Return the heights that the readings show."""
        good = [k for k, n in enumerate(self.with_z) if n not in self.left_out]
        self.with_z, self.z, self.sigma_z = [self.with_z[k] for k in good], self.z[good], self.sigma_z[good]
        if not self.with_z:
            return level(self.film, self.of[used].tolist(), self.bow)
        of = self.of[self.with_z].tolist()
        found = bent(self.film, of, self.z, self.sigma_z, self.bow)
        off = (self.z - found.z_mm(self.film.cad[of])) / self.sigma_z
        misfit, free = (off**2).sum() + ((found.values[3:] / found.prior_mm) ** 2).sum(), max(len(of) - 3, 0)
        if misfit > free + _SIGMAS * math.sqrt(2 * free) + _SIGMAS:
            bow = np.abs(found.values[3:]).max() / self.mm
            message = f"z of the readings fit a board that is bent by {bow:.3g} {self.request.unit} only"
            self.add_reason("readings-z-disagree", message, "Read z again; check sigma_z and bow.")
        return found

    def remark(self, found: Fit, used: list[int], bending: Bending) -> None:
        """State what the readings do not show."""
        unit, says = self.request.unit, self.remarks.append
        if len(used) == 1:
            says(f"one reading shows a shift only: the turn is turn_deg ± {self.request.turn_sigma_deg:g}°")
        if len(used) == 2 and not self._turn_checked:
            says(
                "two readings check one another along their line only: an error across it turns the board unnoticed; "
                "read a third fiducial, or state turn_deg with turn_sigma_deg"
            )
        assumed = [_SHAPE[n] for n in _SHAPE if found.sigma_free(n) > self.prior[n]]
        if assumed:
            says(f"{', '.join(assumed)}: the readings show less than scale_ppm and shear_ppm state, which are taken")
        if self.with_z:
            values, sigma = bending.values / self.mm, np.sqrt(bending.covariance.diagonal()) / self.mm
            what = ("along CAD x", "as a twist", "along CAD y")
            shown = [
                f"{v:+.3g} ± {s:.2g} {unit} {of}"
                for v, s, of in zip(values[3:], sigma[3:], what, strict=True)
                if abs(v) > _SHAPE_SIGMAS * s
            ]
            says(f"edges against the middle, as clamped less as filmed: {', '.join(shown) or 'no bow or twist shown'}")
            if (bending.covariance.diagonal()[3:] > 0.5 * bending.prior_mm**2).any():
                says(f"z of {len(self.with_z)} fiducials do not show all of the bow: it is as filmed, ± bow")
            if max(sigma[1:3]) * self.mm > 0.5 * TILT_MM:
                tilt = f"0 ± {TILT_MM / self.mm:.3g} {unit}"
                says(f"z of {len(self.with_z)} fiducials do not show all of the tilt: it is {tilt}")
            return
        span_mm = 2 * float(self.film.half[1].max()) * self.film.board_type.mm_per_unit
        # The surface of a bent board stretches by half the thickness times the curvature 8·bow / span².
        hidden = 3 * float(np.sqrt(found.covariance[SCALE, SCALE])) * 2 / self.thickness * span_mm**2 / 8
        says(
            f"z counts from the plane through the fiducials as filmed; readings of x and y show no bow below "
            f"{hidden / self.mm:.3g} {unit} over {span_mm / self.mm:.4g} {unit}, and none apart from a scale: give z"
        )
