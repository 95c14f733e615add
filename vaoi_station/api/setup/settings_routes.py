"""Routes under `settings`: station.toml, read with its documentation, checked and changed key by key."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response

from vaoi_station.api.access.access_control import CHANGED
from vaoi_station.api.http_caching import LIVE, require_unchanged, tag_of
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.api.setup.settings_file import SettingsFile
from vaoi_station.api.setup.settings_models import Settings, SettingsChange, SettingsProposal, SettingsSaved
from vaoi_station.api.setup.station_files import StationFiles

Tag = Annotated[
    str, Header(alias="If-Match", description="ETag of what the caller has read; else 412.", max_length=500)
]


def router(services: Services, files: StationFiles) -> APIRouter:
    """Create the routes. All of them need the scope admin."""
    routes, ask = rest_router(prefix="/settings", tags=["setup"]), services.commands.ask
    file = SettingsFile(files)

    @routes.get("", response_model_exclude_none=True)
    async def get_settings(response: Response) -> Settings:
        """Return station.toml as it is on disk, and all keys that it may have, with units, limits and documentation.

        The ETag of the reply is the condition of a change.
        """
        content = await ask(file.content)
        response.headers.update({"Cache-Control": LIVE, "ETag": tag_of(content)})
        return await ask(file.read, content)

    @routes.post("/check", response_model_exclude_none=True)
    async def check_settings(response: Response, wanted: SettingsChange) -> SettingsProposal:
        """Return what station.toml would be after changes: all its faults at once, and the lines that change.

        Nothing is written. Devices are not opened; `vaoi check-config` examines the files that it names as well.
        """
        response.headers["Cache-Control"] = LIVE
        return await ask(lambda: file.propose(wanted.changes, file.content()))

    @routes.put("", response_model_exclude_none=True)
    async def change_settings(request: Request, response: Response, wanted: SettingsChange, _: Tag) -> SettingsSaved:
        """Change station.toml, of which a copy is kept; in force from the next start of the station on.

        Comments and order of the file stay. 412 `changed`: the file has changed since the caller read it; 409
        `settings-read-only`: the service may not write it.
        """
        response.headers["Cache-Control"] = LIVE
        name = files.path.name
        saved = await ask(file.save, wanted.changes, lambda content: require_unchanged(request, content, name))
        # The audit log has the names of what was changed, and no values.
        request.scope["state"][CHANGED] = saved.changed
        return saved

    return routes
