"""Routes under `webhooks`: make, change, test, rotate and delete webhooks; list, retry and drop dead letters."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from typing import Annotated, TypeVar

from fastapi import APIRouter, Path, Query, Request, Response

from vaoi_station.api.http_caching import LIVE, require_unchanged, tag_of
from vaoi_station.api.parameters import IfMatch, rest_router
from vaoi_station.api.receivers.models import (
    DeadLetterList,
    DeliveryResult,
    SecretReply,
    WebhookEntry,
    WebhookList,
    WebhookRequest,
    entry_of,
    letters_of,
    result_of,
)
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import BusyError, NotFoundError
from vaoi_station.push.push_service import PushService, Webhook
from vaoi_station.push.webhook_transport import LIMIT_S

T = TypeVar("T")
Name = Annotated[str, Path(description="Name of a webhook.", pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Number = Annotated[int, Path(description="Number of the event.", ge=0, le=2**53)]
WAIT_S = 2 * LIMIT_S + 5.0
"""Longest wait for a message that is sent on request: another one may be under way."""
OVERLAP_S = 86400


def router(services: Services, push: PushService) -> APIRouter:
    """Create the routes for webhooks."""
    routes = rest_router(tags=["webhooks"])
    ask = services.commands.ask
    # Between the check of If-Match and the change no other caller may change the webhook.
    changing = asyncio.Lock()

    async def require_read(request: Request, name: str) -> None:
        """Raise ChangedError if the webhook is not the one that the caller has read."""
        try:
            present = _settings(await ask(push.webhook, name))
        except NotFoundError:
            present = None
        require_unchanged(request, present, f"Webhook {name!r}")

    @routes.get("/webhooks", response_model_exclude_none=True)
    async def list_webhooks(response: Response) -> WebhookList:
        """List all webhooks and how their deliveries do. Needs the scope admin, as all calls for webhooks do."""
        response.headers["Cache-Control"] = LIVE
        return WebhookList(webhooks=[entry_of(webhook) for webhook in await ask(push.webhooks)])

    @routes.get("/webhooks/{name}", response_model_exclude_none=True)
    async def get_webhook(response: Response, name: Name) -> WebhookEntry:
        """Return one webhook and how its deliveries do. Its ETag is that of its settings: no delivery changes it."""
        response.headers["Cache-Control"] = LIVE
        return _tagged(response, await ask(push.webhook, name))

    @routes.put("/webhooks/{name}", response_model_exclude_none=True)
    async def put_webhook(
        request: Request, response: Response, name: Name, wanted: WebhookRequest, _: IfMatch = None
    ) -> WebhookEntry:
        """Make a webhook, or change one. The reply to the request that makes it has its `secret`.

        A new webhook gets the events from now on. A change takes effect at once: a webhook that is disabled is enabled,
        and what waits is sent again. With `If-Match: ETAG` only if it is still the one that the caller has read: else
        412 `changed`.
        """
        response.headers["Cache-Control"] = LIVE
        async with changing:
            await require_read(request, name)
            secret = await ask(push.put, name, wanted.settings())
            return _tagged(response, await ask(push.webhook, name), secret)

    @routes.delete("/webhooks/{name}", status_code=204)
    async def delete_webhook(request: Request, name: Name, _: IfMatch = None) -> None:
        """Delete a webhook with its dead letters; with `If-Match: ETAG` only the one that the caller has read."""
        async with changing:
            await require_read(request, name)
            await ask(push.delete, name)

    @routes.post("/webhooks/{name}/rotate")
    async def rotate_webhook_secret(
        response: Response,
        name: Name,
        overlap_s: Annotated[
            int, Query(ge=0, le=30 * 86400, description="Time for which the secret before signs as well, s.")
        ] = OVERLAP_S,
    ) -> SecretReply:
        """Make a new secret. Until the one before ends, each message has a signature by both."""
        response.headers["Cache-Control"] = LIVE
        return SecretReply(name=name, secret=await ask(push.rotate, name, float(overlap_s)))

    @routes.post("/webhooks/{name}/test")
    async def test_webhook(response: Response, name: Name) -> DeliveryResult:
        """Send a message of the type `test` now, and reply with what became of it."""
        response.headers["Cache-Control"] = LIVE
        return result_of(await _sent(push.test(name)))

    @routes.post("/webhooks/{name}/enable", response_model_exclude_none=True)
    async def enable_webhook(response: Response, name: Name) -> WebhookEntry:
        """Enable a webhook that was disabled after a long failure, and make the next attempt at once."""
        response.headers["Cache-Control"] = LIVE
        await _sent((await ask(push.webhook, name)).delivery.enable())
        return entry_of(await ask(push.webhook, name))

    @routes.get("/webhooks/{name}/dead-letters", response_model_exclude_none=True)
    async def list_dead_letters(response: Response, name: Name) -> DeadLetterList:
        """List the events that were given up, oldest first."""
        response.headers["Cache-Control"] = LIVE
        return letters_of((await ask(push.webhook, name)).delivery.state)

    @routes.post("/webhooks/{name}/dead-letters/{number}/retry")
    async def retry_dead_letter(response: Response, name: Name, number: Number) -> DeliveryResult:
        """Send an event that was given up once more, out of its order; it is removed if the receiver accepts it."""
        response.headers["Cache-Control"] = LIVE
        return result_of(await _sent((await ask(push.webhook, name)).delivery.retry(number)))

    @routes.delete("/webhooks/{name}/dead-letters/{number}", status_code=204)
    async def drop_dead_letter(name: Name, number: Number) -> None:
        """Remove an event that was given up, without sending it."""
        await _sent((await ask(push.webhook, name)).delivery.drop(number))

    return routes


def _settings(webhook: Webhook) -> bytes:
    """Return what people may edit of a webhook, of which its ETag is made."""
    return webhook.settings.model_dump_json().encode()


def _tagged(response: Response, webhook: Webhook, secret: str | None = None) -> WebhookEntry:
    """Add the ETag of a webhook to its reply, and return its document."""
    response.headers["ETag"] = tag_of(_settings(webhook))
    return entry_of(webhook, secret)


async def _sent(future: Future[T]) -> T:
    """Return what the thread of a receiver has done, without holding a thread meanwhile."""
    try:
        return await asyncio.wait_for(asyncio.wrap_future(future), WAIT_S)
    except TimeoutError:
        raise BusyError(
            f"The receiver's thread has not replied for {WAIT_S:.0f} s: a message is under way.",
            action="Try again; see the state of the webhook.",
        ) from None
