"""Arms of different makes have different colours in the picture of their cell."""

import re
from itertools import combinations
from pathlib import Path

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.web.models import describe_surroundings, primitive_urdf

CELLS = Path(__file__).parents[2] / "deploy/example_cells"
MAKES = {
    "fanuc_draw_wire": "fanuc",
    "fanuc_rmi": "fanuc",
    "universal_robots": "ur",
    "kuka_variables": "kuka",
    "abb_web_services": "abb",
    "yaskawa": "yaskawa",
}
ARM = re.compile(r'<material name="arm">\s*<color rgba="([\d.]+) ([\d.]+) ([\d.]+) 1"')


def test_makes_are_told_apart_by_the_colours_of_their_arms() -> None:
    colours_of_make: dict[str, set[tuple[float, ...]]] = {}
    for name, make in MAKES.items():
        config = read_cell_file(CELLS / f"{name}.toml")
        robot = config.robots[0].name
        found = ARM.search(primitive_urdf(config, robot))
        assert found is not None
        rgb = tuple(float(share) for share in found.groups())
        shown = describe_surroundings(config, robot).arm_rgb
        assert rgb == tuple(round(int(shown[at : at + 2], 16) / 255, 3) for at in (1, 3, 5))
        colours_of_make.setdefault(make, set()).add(rgb)
    assert [len(colours) for colours in colours_of_make.values()] == [1] * 5
    for (one,), (other,) in combinations(colours_of_make.values(), 2):
        assert max(abs(a - b) for a, b in zip(one, other, strict=True)) > 0.15
