"""The child's half of cellcal.drivers.wire.process: answer requests until the parent goes away.

Imports as little as it can: it must start fast and must not touch what a vendor library brings.

Two things end the process even while a library holds the interpreter: SIGALRM with its default action, armed
for every request, and the end of file on the channel, seen between requests. So no child outlives its parent
by more than one deadline.
"""

import contextlib
import json
import os
import signal
import socket
import struct
import sys
from collections.abc import Callable, Mapping
from typing import Any

HEADER = struct.Struct(">I")
LONGEST_FRAME = 1 << 20

_GRACE_S = 0.5  # the parent's deadline comes first; this is for a parent that no longer counts

Handler = Callable[..., Any]


def pack_message(message: Mapping[str, Any]) -> bytes:
    """Return the wire form of one message: its length and its JSON."""
    body = json.dumps(message, allow_nan=False).encode()
    return HEADER.pack(len(body)) + body


def serve_requests(handlers: Mapping[str, Handler]) -> None:
    """Answer requests on the descriptor that the last argument names; end the process with the parent.

    A handler says no with RuntimeError or ValueError, as vendor libraries do. Anything else it raises is a
    bug and ends the process with its traceback on standard error, which the parent keeps.
    """
    table = {"ping": os.getpid, **handlers}
    with socket.socket(fileno=int(sys.argv[-1])) as channel, contextlib.suppress(ConnectionError):
        while (body := _receive_message(channel)) is not None:
            request = json.loads(body)
            signal.setitimer(signal.ITIMER_REAL, float(request["deadline_s"]) + _GRACE_S)
            answer = _answer_request(table[request["verb"]], request["arguments"])
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            channel.sendall(pack_message({"number": request["number"], **answer}))
    # Destructors of vendor objects may wait for a device that is gone.
    sys.stdout.flush()
    os._exit(0)


def _answer_request(handler: Handler, arguments: Mapping[str, Any]) -> dict[str, Any]:
    try:
        return {"value": handler(**arguments)}
    except (RuntimeError, ValueError) as error:
        return {"refused": str(error) or type(error).__name__}


def _receive_message(channel: socket.socket) -> bytes | None:
    header = _receive_exactly(channel, HEADER.size)
    return None if header is None else _receive_exactly(channel, HEADER.unpack(header)[0])


def _receive_exactly(channel: socket.socket, size: int) -> bytes | None:
    parts = bytearray()
    while len(parts) < size:
        part = channel.recv(size - len(parts))
        if not part:
            return None
        parts += part
    return bytes(parts)
