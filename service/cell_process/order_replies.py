"""Replies to orders by the id of the press: an order that is sent twice is executed once."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from typing import Any

from cellcal.calibration.errors import CellError
from cellcal.service.cell_process.messages import Order, SessionCommand
from cellcal.service.session_documents import OrderReply

_REPLIES_KEPT = 1000
_ID_USED: OrderReply = {
    "ok": False,
    "code": "desk.id_used",
    "message": "This press was used for another order.",
    "remedy": "Press again.",
}


class OrderRefusedError(CellError):
    """An order that the cell process does not execute at present."""

    code = "desk.refused"


class OrderReplies:
    """The newest replies, also those that are still being worked on."""

    def __init__(self) -> None:
        self._replies: OrderedDict[str, asyncio.Task[OrderReply]] = OrderedDict()
        self._orders: dict[str, tuple[str, Order]] = {}

    def __contains__(self, command_id: str) -> bool:
        return command_id in self._replies

    async def reply_once(
        self,
        command: SessionCommand,
        execute: Callable[[SessionCommand], Coroutine[Any, Any, OrderReply]],
    ) -> OrderReply:
        """Execute a command unless it has been, or is being, executed; return its reply."""
        order = command.who, command.order
        if command.id not in self._replies:
            self._orders[command.id] = order
            self._replies[command.id] = asyncio.create_task(execute(command))
            while len(self._replies) > _REPLIES_KEPT:
                self._orders.pop(self._replies.popitem(last=False)[0])
        elif self._orders.get(command.id) != order:
            return _ID_USED
        return await asyncio.shield(self._replies[command.id])
