"""What a technician does at the cabinet when an instruction says so, done at the fake cell's control door."""

import re

from cellcal.service.demo.door import Door

_MOUNT = re.compile(r"mount_wire_(\d+)")
_HOOK = re.compile(r"hook_wire_(\d+)")
_MOUTH = re.compile(r"towards x (-?\d+), y (-?\d+), z (-?\d+) mm")
_HOOKED_AT_HOME = ("wire_is_hooked", "hook_stays_on", "hook_wire_back")  # a fixture or a tool may have had it
_AT_THE_CABINET = {"new_battery": "new_battery", "power_cycle": "power_cycle"}


async def lend_a_hand(door: Door, key: str, text: str, wire: str | None = None) -> str:
    """Do what an instruction asks for; return which fault of the door it was, empty where hands have nothing to do.

    ``wire`` is the gauge that the hands are on; None is the only one. Its mouth looks where the text says.
    """
    which = {} if wire is None else {"device": wire}
    if key in _AT_THE_CABINET:
        name = _AT_THE_CABINET[key]
        await door.fault(name)
        return name
    if mount := _MOUNT.fullmatch(key):
        mouth = _MOUTH.search(text)
        told = {} if mouth is None else {"mouth_at_m": [int(value) * 1e-3 for value in mouth.groups()]}
        await door.fault("mount_wire", point=int(mount[1]), **told, **which)
        return "mount_wire"
    if hook := _HOOK.fullmatch(key):
        await door.fault("hook_wire", target=int(hook[1]), **which)
        return "hook_wire"
    if key in _HOOKED_AT_HOME:
        await door.fault("wire_home", **which)
        return "wire_home"
    return ""
