"""Routes under `runs`: list runs, wait for the next one, return results, hold and release frames, decide."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, Field

from vaoi_station.api.http_caching import (
    IMMUTABLE,
    LIVE,
    REVALIDATE,
    conditional_response,
    json_of,
    json_response,
    require_unchanged,
)
from vaoi_station.api.limits import caller_of
from vaoi_station.api.parameters import Address, IfMatch, Moment, RunId, TimeoutS, file_reply, rest_router
from vaoi_station.api.rest_models import DecisionRequest, IdentityReport, Matrices, PlainText, RunPage
from vaoi_station.api.routes.services import Services
from vaoi_station.clamping import Clamped, ClampedRequest
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.model.board_identity import IdentityDocument, ReportedId
from vaoi_station.runs.kept_runs import Wanted
from vaoi_station.runs.states.run_ids import in_utc, is_run_id, last_midnight, utc
from vaoi_station.runs.states.schemas import (
    GoodBoards,
    HeightList,
    LeaseStatus,
    PartPage,
    PartPictures,
    PartsDocument,
    RunCounts,
    RunDetail,
    RunOverlay,
    RunSummary,
    Timeline,
)
from vaoi_station.runs.states.tables import IN_MEMORY
from vaoi_station.store.run_search import RunFilter

Cursor = Annotated[str | None, Query(description="Id of a run.", min_length=1, max_length=64)]
Figures = Annotated[bool, Query(description="Whether figures are wanted, as `trends` has them.")]
Holder = Annotated[PlainText, Query(description="Name of the holder.", min_length=1, max_length=80)]


class RunQuery(BaseModel):
    """Which runs are listed."""

    verdict: Wanted | None = Field(default=None, description="Verdict; `none`: ended without a result.")
    board_type: str | None = Field(default=None, description="Name of the board type.", max_length=200)
    board_id: str | None = Field(default=None, description="The caller's id of the board.", max_length=200)
    reason: str | None = Field(default=None, description="Code or cause of a reason.", max_length=80)
    since: AwareDatetime | None = Field(default=None, description="Boards from this time on, RFC 3339.")
    until: AwareDatetime | None = Field(default=None, description="Boards before this time, RFC 3339.")


async def run_filter(query: Annotated[RunQuery, Query()]) -> RunFilter:
    """Return the filter that a query states."""
    first, last = (None if moment is None else utc(in_utc(moment)) for moment in (query.since, query.until))
    if first is not None and last is not None and first > last:
        raise InputError.field("query", "since", first, f"no later than until ({last})")
    return RunFilter(query.verdict, query.board_type, query.board_id, query.reason, first, last)


def router(services: Services) -> APIRouter:
    """Create the routes for runs; `routes.pictures` and `routes.mosaics` have those for their pictures."""
    routes = rest_router(prefix="/runs", tags=["runs"])
    coordinator, ask, kept = services.coordinator, services.commands.ask, services.coordinator.kept
    # Between the check of If-Match and the decision no other caller may decide.
    seats, search, deciding = services.search_seats, services.searching.ask, asyncio.Lock()

    # Even a finished run changes its state when its frames are released, so clients must revalidate.
    async def shown(request: Request, run: str, cache: str = REVALIDATE, *, figures: bool = False) -> Response:
        return json_response(request, await ask(kept.shown, await ask(coordinator.run, run), figures), cache)

    @routes.get("")
    async def list_runs(
        *,
        request: Request,
        wanted: Annotated[RunFilter, Depends(run_filter)],
        limit: Annotated[int, Query(ge=1, le=500, description="Largest number of runs.")] = 50,
        before: Cursor = None,
        read_id: Annotated[
            str | None,
            Query(description="Id that was read from a board, or reported.", min_length=1, max_length=200),
        ] = None,
        figures: Figures = False,
    ) -> RunPage:
        """List runs, newest first; `next` is the cursor of the next page.

        With a filter, a reply may have fewer runs than `limit`, or none, although there are more: one request reads
        20,000 runs at most. Go on while there is a `next`. With `read_id`, runs are listed of which this id was read
        from a code, or reported by the next machine. As `before` any id of a run is accepted, also of one that was
        deleted meanwhile: the next page has what is older.
        """
        # A wrong cursor, if it was ignored, would list the first page again, and a client that pages would not end. The
        # id of a run is a position also when the run is deleted, because ids sort by time.
        if before is not None and not is_run_id(before):
            await ask(coordinator.run, before)  # raises NotFoundError
        if read_id is not None or wanted != RunFilter():
            runs: Sequence[RunSummary]
            async with seats.take(caller_of(request).name):
                if read_id is not None:
                    runs, more = await search(kept.with_id, read_id, wanted, limit, before)
                else:
                    runs, more = await search(kept.history.find, wanted, limit, before)
                return RunPage(runs=list(await search(kept.all_shown, tuple(runs), figures)), next=more)
        # One more than requested shows whether there is a further page.
        runs = await ask(coordinator.runs, limit + 1, before)
        page = await ask(kept.all_shown, runs[:limit], figures)
        return RunPage(runs=list(page), next=runs[limit - 1].id if len(runs) > limit else None)

    @routes.get("/counts", dependencies=[Depends(seats.hold)])
    async def count_runs(since: Moment = None) -> RunCounts:
        """Count the boards since a time, by verdict, and the boards that passed without a run.

        Without `since`: since the last midnight of the station's time zone.
        """
        return await search(kept.history.counts, in_utc(since) if since else last_midnight())

    @routes.get("/latest", response_model=RunDetail)
    async def get_latest_run(request: Request) -> Response:
        """Return the run that finished last. Replies 404 `no-run-yet` until a first run has finished."""
        run = await ask(coordinator.latest)
        if run is None:
            raise NotFoundError(
                "No board has been filmed yet.",
                action="Arm the station, let a board pass, and try again.",
                code="no-run-yet",
            )
        return json_response(request, await ask(kept.shown, run), REVALIDATE)

    @routes.get("/next", response_model=RunDetail, responses={204: {"description": "No run finished in time."}})
    async def wait_for_next_run(request: Request, after: Cursor = None, timeout: TimeoutS = 30.0) -> Response:
        """Wait for the first run that finished after the run `after` (long poll). Replies 204 on time-out.

        Replies at once if there is such a run. Without `after`, the call waits for the first run that finishes after
        the call. A client that passes the id of each reply as the next `after` gets every finished run exactly once.
        """
        if (run := await _next(services, caller_of(request).name, after, timeout)) is None:
            return Response(status_code=204, headers={"Cache-Control": LIVE})
        return json_response(request, await ask(kept.shown, run), LIVE)

    @routes.get("/{run}", response_model=RunDetail)
    async def get_run(request: Request, run: RunId, figures: Figures = False) -> Response:
        """Return one run, also while it is filmed, with the verdict of every frame."""
        return await shown(request, run, figures=figures)

    @routes.get("/{run}/matrices", response_model=Matrices)
    async def get_matrices(request: Request, run: RunId) -> Response:
        """Return the result of a run in the format of `docs/formats.md`. Replies 409 while there is none yet.

        It is there with the verdict. While `quality.later` names entries, these follow within moments: read it again,
        or wait for the event with the code `explained`.
        """
        cache = IMMUTABLE if await ask(coordinator.is_complete, run) else REVALIDATE
        return json_response(request, (await ask(coordinator.stitch_text, run)).encode(), cache)

    @routes.get("/{run}/heights", response_model=HeightList, dependencies=[Depends(services.picture_seats.hold)])
    async def get_heights(request: Request, run: RunId) -> Response:
        """Measure the heights of all components, and compare them with the board type's: data, not a verdict.

        They are measured after each run (`heights = "after-run"` in station.toml), else at the first request, and kept
        with the result; all requests get the same document. 409: no CAD mapping, or a calibration without working
        distance. 410: the frames are no longer in memory, and the heights were not measured while they were.
        """
        return json_response(request, await services.pictures.ask(coordinator.heights.document, run))

    @routes.get("/{run}/parts", response_model=PartsDocument, dependencies=[Depends(services.picture_seats.hold)])
    async def get_parts(request: Request, run: RunId) -> Response:
        """Measure all parts: is it there, where, turned by how much, which way round, like good ones. No verdict.

        They are measured after each run of a board type with good boards, and kept with the result; without good
        boards at the first request, by heights alone, which holds until a board is taught. `remark_codes` says what
        limits the measures, `marked` of a part which are beyond the limits of its board type. 409: no CAD mapping. 410:
        the frames are no longer in memory, no recording of the run is kept, and the parts were not measured before.
        """
        return json_response(request, await services.pictures.ask(coordinator.parts.document, run), REVALIDATE)

    # Before "/parts/{ref:path}", whose path parameter would match these addresses as well.
    @routes.get(
        "/{run}/parts/{ref:path}/pictures/{view}/{what}",
        response_class=Response,
        responses=file_reply("The picture.", "image/png"),
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_part_picture(
        request: Request,
        run: RunId,
        ref: Address,
        view: Annotated[int, Path(description="Index of the view in the list of the part, from 0.", ge=0, le=99)],
        what: Annotated[
            Literal["part", "good", "difference"], Path(description="The part, the good one, or their difference.")
        ],
    ) -> Response:
        """Return a picture of a part, of the same part of a good board, or their difference, under one light."""
        views = (await services.pictures.ask(coordinator.parts.views, run, ref)).views
        content = getattr(views[view], what) if view < len(views) else None
        if content is None:
            raise NotFoundError(
                f"Part {ref!r} of run {run} has no picture {what!r} of view {view}; it has {len(views)} views.",
                action="Read the list of its views again: the frames, or the good boards, are others now.",
                code="no-such-image",
            )
        return conditional_response(request, content, "image/png", cache=REVALIDATE)

    @routes.get("/{run}/parts/{ref:path}", response_model=PartPage, dependencies=[Depends(services.picture_seats.hold)])
    async def get_part(request: Request, run: RunId, ref: Address) -> Response:
        """Return one part: its stored measure, limits, and its pictures beside those of the most similar good board.

        The pictures are averaged from all frames that show the part, in memory or in the recording of the run; of a
        good board they are what was kept of it. Otherwise, `views` is empty.
        """

        def page() -> PartPage:
            found, board_type = coordinator.parts.views(run, ref), coordinator.run(run).board_type
            address, measure = quote(request.scope["path"]), coordinator.parts.measure_of(run, ref)
            pictures = tuple(
                PartPictures(
                    light=v.light,
                    exposure=v.exposure,
                    **{k: f"{address}/pictures/{n}/{k}" for k in ("part", "good", "difference") if getattr(v, k)},
                )
                for n, v in enumerate(found.views)
            )
            limits = coordinator.parts.limits_of(run, ref)
            return PartPage(
                run=run, board_type=board_type, address=ref, measure=measure, limits=limits, good=found.good,
                views=pictures,
            )  # fmt: skip

        return json_response(request, await services.pictures.ask(page), REVALIDATE)

    @routes.post("/{run}/clamped", response_model=Clamped)
    async def hand_over_clamped(request: Request, run: RunId, readings: ClampedRequest) -> Response:
        """Return where the board lies that a tester has clamped: transforms, points with z and slope, keep-out solids.

        The tester sends where it reads fiducials, in its coordinates and unit; the answer is in these, each number with
        its standard deviation. `status` is never better than the verdict of the run. Readings of the wrong fiducial, of
        another unit, side or board are named in `reasons`; `remarks` state what the readings do not show. Nothing is
        stored. 409: the run has no CAD mapping.
        """
        return json_response(request, await services.explained.ask(coordinator.clamped, run, readings), LIVE)

    @routes.put("/{run}/good", dependencies=[Depends(services.picture_seats.hold)])
    async def keep_as_good(run: RunId) -> GoodBoards:
        """Keep what the parts of this board look like: it is a good one. Later runs of its type are compared with it.

        The reply lists the good boards, parts that look unlike others of their kind, and parts that were measured as
        absent on this one: check these, and remove the board if one is wrong. 410: its frames are no longer in memory,
        and no recording of the run is kept.
        """
        return await services.pictures.ask(coordinator.parts.teach, run)

    @routes.delete("/{run}/good")
    async def remove_from_good(run: RunId) -> GoodBoards:
        """Remove this board from the good ones of its type: it was none after all. Stored measures stay as they are."""
        return await ask(coordinator.parts.forget, run)

    @routes.get("/{run}/timeline", response_model=Timeline)
    async def get_timeline(request: Request, run: RunId) -> Response:
        """Return the times of the steps of a finished run: barrier, pulses, exposures, frames, stitching, result.

        All are seconds since the board interrupted the light barrier.
        """
        return json_response(request, await ask(coordinator.timeline, run))

    @routes.get("/{run}/overlay", response_model=RunOverlay)
    async def get_overlay(request: Request, run: RunId) -> Response:
        """Return what is drawn over the mosaics of a run: its frames, links, fiducials and residuals on the board.

        Places are CAD coordinates, as `image_from_cad` of a mosaic takes them. No frames are needed. 409: the run has
        no CAD mapping.
        """
        return json_response(request, await services.explained.ask(coordinator.mosaics.overlay, run))

    @routes.post("/{run}/release")
    async def release_run(
        run: RunId,
        holder: Annotated[
            PlainText | None, Query(description="Name of the holder.", min_length=1, max_length=80)
        ] = None,
    ) -> RunDetail:
        """Release a finished run's frames, so that their memory is free for the next board. The result is kept.

        Ends the hold of `holder`. Replies 409 `held`, and releases nothing, while another caller holds the run.
        """
        return await ask(kept.shown, await ask(coordinator.release, run, holder))

    @routes.put("/{run}/hold")
    async def hold_run(
        run: RunId,
        holder: Holder,
        purpose: Annotated[PlainText, Query(max_length=200, description="What for; people see it.")] = "",
    ) -> LeaseStatus:
        """Keep a run's frames in memory until the hold expires. A repeated call renews the hold."""
        return await ask(coordinator.hold, run, holder, purpose)

    @routes.delete("/{run}/hold", status_code=204)
    async def let_go_of_run(run: RunId, holder: Holder) -> None:
        """End the hold of one holder on a run; those of others stay. No effect if there is no such hold."""
        await ask(coordinator.end_hold, run, holder)

    @routes.put("/{run}/pin", response_model=RunDetail)
    async def pin_run(request: Request, run: RunId) -> Response:
        """Keep a run until it is unpinned: result and record, and its frames as a recording if they are in memory.

        Replies 410 if result and record were deleted already, 409 `too-many-pins` if 1000 runs are pinned.
        """
        await ask(kept.pin, run)
        return await shown(request, run, LIVE)

    @routes.delete("/{run}/pin", status_code=204)
    async def unpin_run(run: RunId) -> None:
        """Remove the pin of a run; it is then deleted like other runs. Replies 404 `not-pinned` if it has none."""
        await ask(kept.unpin, run)

    @routes.put("/{run}/decision", response_model=RunDetail)
    async def decide_about_run(request: Request, run: RunId, wanted: DecisionRequest, _: IfMatch = None) -> Response:
        """Keep what a person has decided about a run: film the board again, or use its pictures despite the verdict.

        The verdict stays as it is. A later decision replaces an earlier one; the event log has both. With
        `If-Match: ETAG` only if the run is still as the caller has read it: else 412 `changed`.
        """
        async with deciding:
            present = json_of(await ask(kept.shown, await ask(coordinator.run, run)))
            require_unchanged(request, present, f"Run {run}")
            await ask(kept.history.decide, run, wanted.choice, wanted.name, wanted.reason)
        return await shown(request, run, LIVE)

    @routes.get("/{run}/identity")
    async def get_identity(
        request: Request,
        run: RunId,
        timeout: Annotated[float, Query(description="Longest wait for the codes, s.", ge=0, le=60)] = 0.0,
    ) -> IdentityDocument:
        """Return which board a run shows: the ids that were armed, read and reported, and whether they agree.

        Codes are read after the result, if the board type has `identity`: until then `state` is `pending`; with
        `timeout`, the call waits for the end of the reading.
        """
        return await _identity(services, caller_of(request).name, run, timeout)

    @routes.put("/{run}/identity/next-machine")
    async def report_identity(run: RunId, reported: IdentityReport) -> IdentityDocument:
        """Report the id that the next machine has read of the same board; the ids are compared, none is replaced.

        A further report replaces the one before. Replies 409 `identity-pending` while the codes are being read.
        """
        report = ReportedId(board_id=reported.board_id, machine=reported.machine, time=utc())
        return await ask(kept.identities.report, run, report)

    return routes


async def _identity(services: Services, caller: str, run: str, timeout_s: float) -> IdentityDocument:
    """Wait until the codes of a run are read, without occupying a thread; return its identity, read or not."""
    hub, ask, identities = services.hub, services.commands.ask, services.coordinator.kept.identities
    until, seen = time.monotonic() + timeout_s, hub.newest
    identity = await ask(identities.document, run)
    if identity.state != "pending" or timeout_s <= 0:
        return identity
    with hub.polls.take(caller):
        while identity.state == "pending" and (records := await hub.events(seen, until - time.monotonic())):
            seen = records[-1].number
            identity = await ask(identities.document, run)
    return identity


async def _next(services: Services, caller: str, after: str | None, timeout_s: float) -> RunDetail | None:
    """Wait for the next finished run without occupying a thread; return None on time-out."""
    hub, ask, coordinator = services.hub, services.commands.ask, services.coordinator
    until = time.monotonic() + timeout_s
    # The event number is read before the run list: a run that finishes in between is found by its event.
    seen = hub.newest if after is not None else (await ask(coordinator.snapshot)).last_event
    with hub.polls.take(caller):
        while True:
            if after is not None and (run := await ask(coordinator.next_run, after, 0.0)) is not None:
                return run
            records = await hub.events(seen, until - time.monotonic())
            if not records:
                return None
            seen = records[-1].number
            for record in records:
                if after is None and record.kind == "run" and record.run and record.state in IN_MEMORY:
                    return await ask(coordinator.run, record.run)
