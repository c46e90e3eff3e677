"""Every fault that a fake device knows stands in the list of its faults, by its name."""

import re
from pathlib import Path

from cellcal.service.demo.fake_cell_client import FakeCellClient

FAKES = Path(__file__).parents[2] / "fake_devices"


async def test_every_fault_is_in_the_readme(fake_client: FakeCellClient) -> None:
    devices = (await fake_client.send_command("faults"))["faults"]
    general = (FAKES / "README.md").read_text(encoding="utf-8")
    of_brand = dict.fromkeys(("ur", "ur_x"), FAKES / "universal_robots" / "README.md")
    assert {"fanuc", "ur", "rmi", "kuka", "abb", "motoman", "any_maker", "wire", "probe"} <= devices.keys()
    missing = {}
    for device, names in devices.items():
        own = of_brand.get(device)
        listed = set(re.findall(r"`(\w+)", general + (own.read_text(encoding="utf-8") if own else "")))
        missing[device] = sorted(set(names) - listed)
    assert not {device: names for device, names in missing.items() if names}
