"""Values of nodes, taken only where the server stands behind them and where they are what the document says."""

import math
from collections.abc import Sequence
from typing import Any

from asyncua import ua

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WireProtocolError

_FLOATS = frozenset((ua.VariantType.Double, ua.VariantType.Float))
_INTEGERS = frozenset(
    (
        ua.VariantType.Int16, ua.VariantType.Int32, ua.VariantType.Int64, ua.VariantType.SByte,
        ua.VariantType.Byte, ua.VariantType.UInt16, ua.VariantType.UInt32, ua.VariantType.UInt64,
    )
)  # fmt: skip
_LOOK = "Look at the controller and its OPC UA server; try again when the value is good there."
_REPORT = "Report this with the name and the version of the server."


def read_float(device: str, node: str, value: ua.DataValue) -> float:
    """Return a finite number.

    Raises
    ------
    RefusedError
        The server gives the value with a bad or uncertain status.
    WireProtocolError
        It is no number, or not a finite one.
    """
    number = float(_content_of(device, node, value, _FLOATS))
    if not math.isfinite(number):
        raise _type_error(device, node, repr(number))
    return number


def read_integer(device: str, node: str, value: ua.DataValue) -> int:
    """Return a whole number; raises as `read_float`."""
    return int(_content_of(device, node, value, _INTEGERS))


def read_flag(device: str, node: str, value: ua.DataValue) -> bool:
    """Return a truth value; raises as `read_float`."""
    return bool(_content_of(device, node, value, frozenset((ua.VariantType.Boolean,))))


def read_text(device: str, node: str, value: ua.DataValue) -> str:
    """Return a text, also one with a locale; raises as `read_float`."""
    allowed = frozenset((ua.VariantType.String, ua.VariantType.LocalizedText))
    content = _content_of(device, node, value, allowed, may_be_empty=True)
    return str((content.Text if isinstance(content, ua.LocalizedText) else content) or "").strip()


def read_texts(device: str, node: str, value: ua.DataValue) -> tuple[str, ...]:
    """Return a list of texts; raises as `read_float`."""
    _check_status(device, node, value)
    variant = value.Value
    content = None if variant is None else variant.Value
    if not isinstance(content, list) or not all(isinstance(each, str) for each in content):
        raise _type_error(device, node, type(content).__name__)
    return tuple(content)


def read_structure(device: str, node: str, value: ua.DataValue) -> object:
    """Return what a structured value holds; raises as `read_float`."""
    return _content_of(device, node, value, frozenset((ua.VariantType.ExtensionObject,)))


def check_value_count(device: str, values: Sequence[ua.DataValue], expected: int) -> None:
    """Refuse an answer with more or fewer values than were asked for."""
    if len(values) != expected:
        raise WireProtocolError(
            device,
            "the OPC UA server answered with more or fewer values than it was asked for.",
            remedy=_REPORT,
        )


def _content_of(
    device: str,
    node: str,
    value: ua.DataValue,
    allowed: frozenset[ua.VariantType],
    *,
    may_be_empty: bool = False,
) -> Any:
    _check_status(device, node, value)
    variant = value.Value
    if variant is None or variant.VariantType not in allowed or isinstance(variant.Value, list):
        raise _type_error(device, node, "nothing" if variant is None else variant.VariantType.name)
    if variant.Value is None and not may_be_empty:
        raise _type_error(device, node, "nothing")
    return variant.Value


def _check_status(device: str, node: str, value: ua.DataValue) -> None:
    status = value.StatusCode
    if (
        status is not None and status.value != ua.StatusCodes.Good
    ):  # also GoodLocalOverride: a value set by hand
        raise RefusedError(
            device,
            make_message(
                "the OPC UA server gives {node} with the status {status} and does not stand behind it.",
                node=node,
                status=status.name,
            ),
            remedy=_LOOK,
            vendor_code=int(status.value),
            vendor_text=status.name,
        )


def _type_error(device: str, node: str, found: str) -> WireProtocolError:
    return WireProtocolError(
        device,
        make_message(
            "the OPC UA server gives {node} as {found}, which it cannot be.", node=node, found=found
        ),
        remedy=_REPORT,
    )
