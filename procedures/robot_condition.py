"""The condition of a robot that answers: a lost link is an error, never a robot without alarms.

`Device.read_condition` tells of a lost link by its readiness, for pages and watches. A step that looks for alarms in
such a condition finds none, and a lost position would pass for a kept one.
"""

from cellcal.drivers.errors import UnreachableError
from cellcal.drivers.interfaces import Condition, Device, Readiness


async def read_reached_condition(device: Device) -> Condition:
    """Return the condition; a step that raises is tried again.

    Raises
    ------
    UnreachableError
        The device does not answer.
    """
    condition = await device.read_condition()
    if condition.readiness is Readiness.UNREACHABLE:
        raise UnreachableError(device.name, condition.message, remedy=condition.remedy)
    return condition
