"""Routes under `optics`: plan cameras, lens, exposure and pulses of a line. They compute, and change nothing."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response

from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.known_requirements import known_requirements
from vaoi_station.api.setup.optics_models import KnownRequirements, OpticsPlan, PlanOptions
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.errors import VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.model import Calibration
from vaoi_station.optics import make_plan
from vaoi_station.optics.paper_example import PAPER
from vaoi_station.optics.remedies import find_remedies

Options = Annotated[PlanOptions, Query()]
Of = Annotated[
    Literal["station", "paper"],
    Query(description="This station, by station.toml and its calibration, or the example of the paper."),
]


def router(services: Services, files: StationFiles) -> APIRouter:
    """Create the routes."""
    routes, ask = rest_router(prefix="/optics", tags=["setup"]), services.commands.ask

    @routes.get("/plan", response_model_exclude_none=True)
    async def plan_optics(response: Response, options: Options) -> OpticsPlan:
        """Compute an optics plan as `vaoi plan` does: figures, constraints with margins, and remedies.

        A violated constraint is no refusal. Figures that the requirements leave open are absent.
        """
        response.headers["Cache-Control"] = LIVE
        return await ask(_plan, options)

    @routes.get("/requirements")
    async def get_optics_requirements(response: Response, of: Of = "station") -> KnownRequirements:
        """Return requirements to begin a plan with, and for each of them where it is stated."""
        response.headers["Cache-Control"] = LIVE
        return await ask(_of_paper) if of == "paper" else await ask(_of_station, files)

    return routes


def _plan(options: PlanOptions) -> OpticsPlan:
    made = make_plan(options.requirements())
    return OpticsPlan(
        requirements=made.requirements,
        array=made.array,
        lens=made.lens,
        motion=made.motion,
        data=made.data,
        constraints=made.constraints,
        ok=made.ok,
        remedies=find_remedies(made),
    )


def _of_paper() -> KnownRequirements:
    given = {name: float(value) for name, value in vars(PAPER).items() if value is not None}
    return KnownRequirements(values=given, sources=dict.fromkeys(given, "paper"))


def _of_station(files: StationFiles) -> KnownRequirements:
    known = known_requirements(files.config, _calibration(files))
    return KnownRequirements(
        values={name: value for name, (value, _) in known.items()},
        sources={name: source for name, (_, source) in known.items()},
    )


def _calibration(files: StationFiles) -> Calibration | None:
    """Return the calibration as it is on disk; None if it cannot be read, which other pages state."""
    try:
        return read_calibration(files.config.calibration)
    except VaoiError:
        return None
