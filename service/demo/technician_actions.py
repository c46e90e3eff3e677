"""What a technician does at the cabinet when an instruction says so, done through the fake cell's control port."""

import re

from cellcal.service.demo.fake_cell_client import FakeCellClient

_MOUNT = re.compile(r"mount_wire_(\d+)")
_HOOK = re.compile(r"hook_wire_(\d+)")
_MOUTH = re.compile(r"towards x (-?\d+), y (-?\d+), z (-?\d+) mm")
_HOOKED_AT_HOME = ("wire_is_hooked", "hook_stays_on", "hook_wire_back")  # a fixture or a tool may have had it
_AT_THE_CABINET = {"new_battery": "new_battery", "power_cycle": "power_cycle"}


async def perform_instruction(fake_cell: FakeCellClient, key: str, text: str, wire: str | None = None) -> str:
    """Do what an instruction asks for; return the name of the fault, empty where nothing is to be done by hand.

    ``wire`` is the gauge that the hands are on; None is the only one. Its mouth looks where the text says.
    """
    which = {} if wire is None else {"device": wire}
    if key in _AT_THE_CABINET:
        name = _AT_THE_CABINET[key]
        await fake_cell.inject_fault(name)
        return name
    if mount := _MOUNT.fullmatch(key):
        mouth = _MOUTH.search(text)
        mouth_argument = (
            {} if mouth is None else {"mouth_at_m": [int(value) * 1e-3 for value in mouth.groups()]}
        )
        await fake_cell.inject_fault("mount_wire", point=int(mount[1]), **mouth_argument, **which)
        return "mount_wire"
    if hook := _HOOK.fullmatch(key):
        await fake_cell.inject_fault("hook_wire", target=int(hook[1]), **which)
        return "hook_wire"
    if key in _HOOKED_AT_HOME:
        await fake_cell.inject_fault("wire_home", **which)
        return "wire_home"
    return ""
