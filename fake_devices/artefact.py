"""What a probe can touch: planes, balls and pins that stand in the cell.

Imitates
    Reference artefacts: a ground plate, a ceramic ball on a shank, a pin with a round end.
Source
    The [[fake.artefact]] tables of a cell file. Distances are plain geometry: to a plane, a point, a line segment.
Modelled
    Where an artefact really stands: its table's place and a hidden displacement from there.
Not modelled
    Form errors, elastic marks where a tip presses, shanks and edges.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellcal.fake_devices.kinematics import Array

KINDS = ("plane", "sphere", "pin")


class Artefact:
    """One thing, seen from the base of one robot."""

    def __init__(self, table: Mapping[str, Any], rng: np.random.Generator, amount: float) -> None:
        self.name, self.kind = str(table["name"]), str(table["kind"])
        if self.kind not in KINDS:
            raise ValueError(f"an artefact is a {', a '.join(KINDS)}, not a {self.kind!r}")
        self.robot = str(table["robot"])
        shift = np.clip(rng.normal(size=3), -2.0, 2.0) * float(table.get("sigma_mm", 1.0)) * 1e-3
        self.place_in_base_m = np.array(table["place_in_base_mm"], dtype=float) * 1e-3 + amount * shift
        axis = np.array(table.get("axis_in_base", (0.0, 0.0, 1.0)), dtype=float)
        self.axis_in_base = axis / np.linalg.norm(
            axis
        )  # a plane's outward normal; from a pin's foot to its end
        self.radius_m = float(table.get("radius_mm", 0.0)) * 1e-3
        self.length_m = (
            float(table.get("length_mm", 50.0)) * 1e-3
        )  # of a pin, from its end's centre to its foot

    def clearance_m(self, point_m: Array) -> float:
        """Return how far a point is from the surface; negative inside."""
        way = point_m - self.place_in_base_m
        along = float(way @ self.axis_in_base)
        if self.kind == "plane":
            return along
        nearest = np.clip(along, -self.length_m, 0.0) * self.axis_in_base if self.kind == "pin" else 0.0
        return float(np.linalg.norm(way - nearest)) - self.radius_m

    def outward_direction(self, point_m: Array) -> Array:
        """Return the direction (3,) that leads away from the surface fastest."""
        step = 1e-6
        rise = [
            self.clearance_m(point_m + step * axis) - self.clearance_m(point_m - step * axis)
            for axis in np.eye(3)
        ]
        slope = np.array(rise)
        return np.asarray(slope / max(float(np.linalg.norm(slope)), 1e-15))

    def true_state(self) -> dict[str, Any]:
        """Return what it is and where it stands, ready for JSON."""
        return {
            "kind": self.kind,
            "robot": self.robot,
            "place_in_base_m": self.place_in_base_m.tolist(),
            "axis_in_base": self.axis_in_base.tolist(),
            "radius_m": self.radius_m,
        }
