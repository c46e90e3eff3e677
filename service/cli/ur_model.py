"""``cellcal ur-model``: a model file from a Universal Robots controller, for an arm that the catalogue lacks."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def ur_model(
    address: str,
    /,
    *,
    arm: str,
    to: Annotated[Path, Parameter(name="--out")],
    timeout_s: Annotated[float, Parameter(name="--timeout")] = 5.0,
) -> int:
    """Write the model file of an arm from what its Universal Robots controller tells; nothing is sent to it.

    For the arms of which no public source has the lengths (`cellcal models ur` lists those that ship).

    Parameters
    ----------
    address
        Address of the controller; its port 30001 must not be blocked.
    arm
        The arm on the label: ur15, ur7e, ur8long.
    to
        File to write, such as ur15.toml.
    timeout_s
        Seconds that the controller may take.
    """
    import asyncio

    from rich.console import Console

    from cellcal.drivers.universal_robots.factory_calibration import read_controller_arm
    from cellcal.service.engineering.parameters.ur_model_file import ur_model_text
    from cellcal.service.files import SHARED_FILE, create_file, refuse_existing

    refuse_existing(to)
    found = asyncio.run(read_controller_arm(f"the arm at {address}", address, deadline_s=timeout_s))
    create_file(to, ur_model_text(found, arm, address).encode(), mode=SHARED_FILE)
    console = Console(stderr=True, emoji=False, highlight=False)
    if found.factory.is_measured:
        console.print(f'Written: {to}. Into the entry of the robot: model = "{to}", arm_type = "{arm}",')
        console.print(
            f'calibration = "{found.factory.name}". Compare the lengths with the data sheet.', soft_wrap=True
        )
        return 0
    console.print(f'Written: {to}. Into the entry of the robot: model = "{to}", arm_type = "{arm}".')
    console.print(
        f"The controller says that its factory calibration is not linearised (status {found.factory.status}): it may "
        "be that of the drawing, and does not tell this arm from others of its type. Have it looked at by the maker.",
        soft_wrap=True,
    )
    return 0
