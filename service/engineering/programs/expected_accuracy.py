"""What accuracy a new point may be expected to have, from the covariances of both cells; k = 2."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.programs.fixture_postures import fixture_postures
from cellcal.calibration.programs.tip_spread import TipSpread, expanded_uncertainty, frame_covariances
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool

_FEWEST = 4  # postures that tell the rigid motion which fixture and arm share
_BLOCK = 16384
_MOST_REFERENCES = 200
_MOSTLY = 0.7  # of the error remains without some parameters: less says that they are most of it, in squares
_NOTICED = 0.01  # share of the error that a parameter alone takes away, where it is named
_MOST_NAMED = 4


@dataclass(frozen=True, eq=False)
class TransferEnds:
    """The two ends of a transfer: joints (N, n) and tools there."""

    source_rad: Array
    target_rad: Array
    source_tool: ProjectTool
    target_tool: ProjectTool


@dataclass(frozen=True, eq=False)
class Expectation:
    """The known accuracy of two cells and of the frames between them.

    ``one_cell`` says that both ends are one robot, whose errors at both postures go together; ``nominal`` that the
    source is a computed place, which has no error.
    """

    source: Project
    target: Project
    change: Array  # (4, 4) or (N, 4, 4): source's base seen from the target's
    change_covariance: Array | None = None  # (6, 6) of its right twist; None: exact
    one_cell: bool = False
    nominal: bool = False
    source_carrier: Array | None = None  # (N, 4, 4) what external axes put between arm and cell at the source
    unknown: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        ends = [self.target] if self.nominal or self.one_cell else [self.source, self.target]
        remarks: list[str] = []
        for project in ends:
            remarks += project.doubts
            if project.identified is None:
                remarks.append(
                    make_message(
                        "no accuracy can be foretold: {path_name} names no parameters of {serial}",
                        path_name=project.file_name,
                        serial=project.serial,
                    )
                )
            elif project.identified.covariance is None:
                remarks.append(
                    make_message(
                        "no accuracy can be foretold: the parameters of {serial} keep no correlations",
                        serial=project.serial,
                    )
                )
            elif project.identified.held_out_rms_m is None:
                remarks.append(
                    make_message(
                        "the expected error counts what the parameters of {serial} leave open, not what no "
                        "parameter describes: give {setting}",
                        serial=project.serial,
                        setting=project.held_out_setting,
                    )
                )
        object.__setattr__(self, "unknown", tuple(remarks))

    def errors_m(self, ends: TransferEnds) -> Array:
        """Return U (k = 2) of every point in its worst direction (N,); NaN where a covariance is missing."""
        arms = self._tip_spreads(ends)
        found = np.full(len(ends.target_rad), np.nan)
        if arms is None:
            return found
        for first in range(0, len(found), _BLOCK):
            block = slice(first, first + _BLOCK)
            found[block] = expanded_uncertainty(self._tip_covariances(arms, ends, block))
        return found

    def error_at_m(self, ends: TransferEnds, row: int) -> float:
        """Return the same of one point; the others say only what fixture and arm share."""
        arms = self._tip_spreads(ends)
        if arms is None:
            return math.nan
        return float(expanded_uncertainty(self._tip_covariances(arms, ends, slice(row, row + 1)))[0])

    def undetermined_remarks(self, ends: TransferEnds, errors_m: Array) -> tuple[str, ...]:
        """Return which assumed parameters make up most of the largest expected error; nothing where they do not."""
        if not np.isfinite(errors_m).any():
            return ()
        worst = int(np.nanargmax(errors_m))
        largest_m = float(errors_m[worst])
        remarks: list[str] = []
        for project in dict.fromkeys((self.target, self.source)):
            names = _undetermined_of(project)
            if not names or self._error_without(project, names, ends, worst) > _MOSTLY * largest_m:
                continue
            without = {name: self._error_without(project, (name,), ends, worst) for name in names}
            found = [name for name in names if without[name] < (1.0 - _NOTICED) * largest_m] or list(names)
            remarks.append(
                make_message(
                    "the expected error of up to {error_mm:.2f} mm is mostly that of {names} of {serial}, "
                    "which no measurement determined: measure this robot so that they show, or name a fixture "
                    "that it measured",
                    error_mm=largest_m * 1e3,
                    names=join_messages(", ", sorted(found, key=without.__getitem__)[:_MOST_NAMED]),
                    serial=project.serial,
                )
            )
        return tuple(remarks)

    def _error_without(self, project: Project, names: Sequence[str], ends: TransferEnds, row: int) -> float:
        """Return the expected error [m] of one point if some parameters of a project were exact."""
        arm = project.identified
        if arm is None or arm.covariance is None or arm.layout is None:
            return math.inf
        is_open = np.array([p.name not in names for p in arm.layout.parameters])
        if not (np.diag(arm.covariance)[is_open] > 0.0).any():
            return 0.0
        known = replace(
            project, identified=replace(arm, covariance=arm.covariance * np.outer(is_open, is_open))
        )
        source, target = (known if end is project else end for end in (self.source, self.target))
        return replace(self, source=source, target=target).error_at_m(ends, row)

    def _tip_covariances(self, arms: Mapping[str, TipSpread], ends: TransferEnds, block: slice) -> Array:
        turn = (self.change if self.change.ndim == 2 else self.change[block])[..., :3, :3]
        joints = ends.target_rad[block]
        if self.one_cell:
            there, here = arms["target"].tip_slopes(joints), arms["source"].tip_slopes(ends.source_rad[block])
            turned = np.einsum("ij,rjn->rin" if turn.ndim == 2 else "nij,rjn->rin", turn, here)
            apart = (there - turned).transpose(2, 1, 0)
            total = apart @ apart.swapaxes(1, 2)
        else:
            total = arms["target"].tip_covariances(joints)
        if not (self.one_cell or self.nominal):
            total = total + turn @ arms["source"].tip_covariances(ends.source_rad[block]) @ turn.swapaxes(
                -1, -2
            )
        if self.change_covariance is not None:
            places = arms["source"].tip_arm.compute_frames(ends.source_rad[block].T)[1][-1].T
            view_turn = turn
            if self.source_carrier is not None:
                carrier = self.source_carrier[block]
                places = np.einsum("nij,nj->ni", carrier[:, :3, :3], places) + carrier[:, :3, 3]
                view_turn = turn @ carrier[:, :3, :3].swapaxes(1, 2)
            total = total + view_turn @ frame_covariances(
                self.change_covariance, places
            ) @ view_turn.swapaxes(-1, -2)
        variance = self._left_over(self.target) + ends.target_tool.sigma_m**2
        if not self.nominal:
            variance += self._left_over(self.source) + ends.source_tool.sigma_m**2
        return np.asarray(total + variance * np.eye(3), dtype=np.float64)

    @staticmethod
    def _left_over(project: Project) -> float:
        found = None if project.identified is None else project.identified.held_out_rms_m
        return (found or 0.0) ** 2

    def _tip_spreads(self, ends: TransferEnds) -> dict[str, TipSpread] | None:
        target = _tip_spread(self.target, ends.target_tool, ends.target_rad)
        if self.nominal:
            return None if target is None else {"target": target}
        source = _tip_spread(self.source, ends.source_tool, ends.source_rad)
        if source is None or target is None:
            return None
        if self.one_cell:  # what both ends share falls out between them
            source, target = replace(source, shared=None), replace(target, shared=None)
        return {"source": source, "target": target}


def _undetermined_of(project: Project) -> tuple[str, ...]:
    """Return the assumed parameters of the arm itself: a tool and a base are found anew."""
    arm = project.identified
    if arm is None or arm.layout is None:
        return ()
    return tuple(p.name for p in arm.layout.parameters if p.name in arm.undetermined)


def _tip_spread(project: Project, tool: ProjectTool, joints_rad: Array) -> TipSpread | None:
    """Return a cell's spread against its fixture; against the program's own points where no fixture is known."""
    arm = project.identified
    if arm is None or arm.covariance is None or arm.layout is None or not len(joints_rad):
        return None
    spread = TipSpread(replace(arm.state, flange_tool=tool.real), arm.layout, arm.covariance).with_own_tool()
    found = project.alignment
    references = joints_rad[:0]
    if found is not None:
        pose = found.base_fixture.to_matrix()
        points = np.array(found.points_in_fixture_m) @ pose[:3, :3].T + pose[:3, 3]
        references = fixture_postures(spread.tip_arm, project.nominal, points, joints_rad)
    if len(references) < _FEWEST:
        references = joints_rad[:: -(-len(joints_rad) // _MOST_REFERENCES)]
    return spread.relative_to(references) if len(references) >= _FEWEST else spread
