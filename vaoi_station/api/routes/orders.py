"""Routes under `orders`: the orders that wait for their boards."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path

from vaoi_station.api.parameters import rest_router
from vaoi_station.api.rest_models import OrderChange, OrderRequest
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.runs.control.order_requests import WantedOrder
from vaoi_station.runs.states.schemas import OrderList, OrderStatus

OrderId = Annotated[str, Path(description="Id of an order, as `orders` lists it.", pattern=r"^[0-9a-z-]{1,64}$")]


def router(services: Services) -> APIRouter:
    """Create the routes for orders."""
    routes = rest_router(prefix="/orders", tags=["orders"])
    orders, ask = services.coordinator.orders, services.commands.ask

    @routes.get("")
    async def list_orders() -> OrderList:
        """List the orders that no board has taken yet, the next one first."""
        return await ask(orders.list)

    @routes.post("", status_code=201)
    async def add_order(wanted: OrderRequest) -> OrderStatus:
        """Let an order wait for its board, behind all of the same or a higher priority; it survives a restart.

        Each board that reaches the barrier takes the first order that waited then; with messages of the machine
        upstream, the one that is for this board. The line must be armed: for orders (`arm` with `orders`), or for a
        board type, whose boards come when no order waits. 404: unknown board type; 409 `order-exists`: an order for
        this board id waits, `too-many-orders`: 200 wait.
        """
        return await ask(orders.add, WantedOrder(**wanted.model_dump()))

    @routes.patch("/{order}")
    async def move_order(order: OrderId, change: OrderChange) -> OrderStatus:
        """Give an order another position in the queue, or another priority. 409 `order-taken`: its board is coming."""
        if (change.position is None) == (change.priority is None):
            raise InputError("The request must have either position or priority.", action="Give one of the two.")
        return await ask(orders.move, order, change.position, change.priority)

    @routes.delete("/{order}", status_code=204)
    async def withdraw_order(order: OrderId) -> None:
        """Withdraw an order. A board that is at the barrier keeps it. 404 `unknown-order`: it does not wait."""
        await ask(orders.withdraw, order)

    return routes
