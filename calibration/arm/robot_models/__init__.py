"""Nominal robots as data: checked TOML files of some, and a catalogue of many read from public descriptions.

Names alone are told here, without the mathematics that numbers need: `cellcal models` lists them.
"""

from functools import cache
from importlib.resources import files

from cellcal.calibration.arm.robot_models.catalogue_index import usable_names


@cache
def model_names() -> tuple[str, ...]:
    """Return the names of the models with a checked file of their own, sorted."""
    return tuple(
        sorted(f.name.removesuffix(".toml") for f in files(__package__).iterdir() if f.name.endswith(".toml"))
    )


@cache
def known_names() -> frozenset[str]:
    """Return the names of all robots that ship."""
    return frozenset(model_names()) | usable_names()
