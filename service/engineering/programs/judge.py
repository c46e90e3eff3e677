"""What every new point is checked for before it is written: reach, limits, singularity, configuration, collision."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.motion.collision import CollisionCheck, Contact
from cellcal.calibration.programs.transfer import Transferred, smallest_sigma
from cellcal.drivers.programs.brands import ConfigurationRule, SharedConfigurations
from cellcal.service.engineering.programs.cell_of_program import Points, Rows
from cellcal.service.engineering.programs.project import Project

_ROUNDED_RAD = 1e-6
_FLIPPED_RAD = 0.5 * np.pi


@dataclass(frozen=True, eq=False)
class Judge:
    """Checks points of one cell; what fails is said in ``points.reasons``."""

    project: Project
    rule: ConfigurationRule | None
    collisions: CollisionCheck | None

    @classmethod
    def of(cls, project: Project, rule: ConfigurationRule | None) -> "Judge":
        """Prepare the checks of a cell; without shapes there is none for collisions."""
        shapes = project.shapes
        check = None if shapes is None else CollisionCheck.prepare(project.controller, shapes)
        return cls(project, rule, check)

    def judge(self, points: Points, rows: Rows, before_rad: Array, found: Transferred) -> None:
        """Say of each point why it must be left.

        Parameters
        ----------
        points : Points
            Their reasons are added to.
        rows : (K,)
            The points that were transferred.
        before_rad : (K, n)
            Their joints in the cell they come from.
        found : Transferred
            Where they would go.
        """
        points.refuse(
            rows[~found.reached],
            _said(
                rows[~found.reached],
                found.left_m[~found.reached],
                "unreachable: the arm ends {:.1f} mm away",
                1e3,
            ),
        )
        self._limits(points, rows, found.joints_rad)
        sigma = smallest_sigma(self.project.controller, found.joints_rad, self.project.smallest_sigma)
        near = sigma < self.project.smallest_sigma
        words = f"near a singularity: {{:.4f}} m/rad, at least {self.project.smallest_sigma:g} is wanted"
        points.refuse(rows[near], _said(rows[near], sigma[near], words))
        self._flips(points, rows, before_rad, found.joints_rad)
        self._configurations(points, rows, found.joints_rad)
        self._collisions(points, rows, found.joints_rad)

    def _limits(self, points: Points, rows: Rows, joints: Array) -> None:
        model = self.project.controller
        beyond = np.maximum(model.lower_rad - joints, joints - model.upper_rad)
        worst = np.argmax(beyond, axis=1)
        excess = beyond[np.arange(len(rows)), worst]
        over = excess > _ROUNDED_RAD
        told = {
            int(i): f"joint {joint + 1} would pass its limit by {np.degrees(by):.1f} deg"
            for i, joint, by in zip(rows[over], worst[over], excess[over], strict=True)
        }
        points.refuse(rows[over], told.__getitem__)

    def _flips(self, points: Points, rows: Rows, before: Array, joints: Array) -> None:
        """Find wrists that turn over: the same pose in another way, joints 4 and 6 by half a turn each."""
        turned = np.abs(joints - before)
        flipped = (turned[:, 3] > _FLIPPED_RAD) & (turned[:, 5] > _FLIPPED_RAD)
        points.refuse(rows[flipped], "the wrist would flip")

    def _configurations(self, points: Points, rows: Rows, joints: Array) -> None:
        if self.rule is None:
            return
        said = [i for i in np.flatnonzero(points.cartesian[rows]).tolist() if points.texts[int(rows[i])]]
        texts = [points.texts[int(rows[i])] for i in said]
        same = self.rule.keeps_posture(self.project.controller, joints[said], texts)
        other = [i for i, agrees in zip(said, same.tolist(), strict=True) if not agrees]
        if other:
            old = [points.texts[int(rows[i])] for i in other]
            new = self.rule.spelled(self.project.controller, joints[other], old)
            told = {
                int(rows[i]): f"the wrist would flip or the arm change its posture: {a} would become {b}"
                for i, a, b in zip(other, old, new, strict=True)
            }
            points.refuse(rows[other], told.__getitem__)

    def _collisions(self, points: Points, rows: Rows, joints: Array) -> None:
        if self.collisions is None:
            return
        bad = np.flatnonzero(~self.collisions.free(joints))
        contacts = self.collisions.narrowest(joints[bad]) if len(bad) else ()
        told = {int(rows[i]): _contact(contact) for i, contact in zip(bad, contacts, strict=True)}
        points.refuse(rows[bad], told.__getitem__)

    def spelled(self, points: Points, rows: Rows, joints: Array) -> dict[int, str]:
        """Return the configurations that must be written anew, by point: turn numbers that are others now."""
        if self.rule is None:
            return {}
        said = [i for i in np.flatnonzero(points.cartesian[rows]).tolist() if points.texts[int(rows[i])]]
        texts = [points.texts[int(rows[i])] for i in said]
        same = self.rule.agrees(self.project.controller, joints[said], texts, turns=True)
        other = [i for i, agrees in zip(said, same.tolist(), strict=True) if not agrees]
        if not other:
            return {}
        old = [points.texts[int(rows[i])] for i in other]
        new = self.rule.spelled(self.project.controller, joints[other], old)
        if isinstance(self.rule, SharedConfigurations):
            for i, before, after in zip(other, old, new, strict=True):
                points.refuse(rows[[i]], self.rule.refuses_change(before, after))
            return {}
        right = self.rule.agrees(self.project.controller, joints[other], new, turns=True)
        told = {int(rows[i]): text for i, text in zip(other, new, strict=True)}
        wrong = [int(rows[i]) for i, agrees in zip(other, right.tolist(), strict=True) if not agrees]
        points.refuse(
            np.array(wrong, dtype=np.intp), "its configuration cannot be written in the file's spelling"
        )
        return {i: text for i, text in told.items() if i not in wrong}


def _contact(contact: Contact) -> str:
    if contact.clearance_m <= 0:
        return f"collides: {contact.first} and {contact.second}"
    return f"comes too close: {contact.clearance_m * 1e3:.0f} mm between {contact.first} and {contact.second}"


class _Said:
    def __init__(self, rows: Rows, values: Array, words: str, factor: float) -> None:
        self._by_row = dict(zip(rows.tolist(), values.tolist(), strict=True))
        self._words, self._factor = words, factor

    def __call__(self, row: int) -> str:
        return self._words.format(self._by_row[row] * self._factor)


def _said(rows: Rows, values: Array, words: str, factor: float = 1.0) -> _Said:
    return _Said(rows, values, words, factor)
