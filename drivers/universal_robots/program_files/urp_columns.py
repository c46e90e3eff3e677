"""Waypoints in columns: where each is, from its own joints, tool and kinematics."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellcal.calibration.geometry import Array, Pose, inverse_transform
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Positions
from cellcal.drivers.universal_robots.program_files.script_numbers import DOUBLE_STEP, poses_of, six_of
from cellcal.drivers.universal_robots.program_files.urp_kinematics import DhChain
from cellcal.drivers.universal_robots.program_files.urp_waypoints import BASE, SixNumbers, Waypoint
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

_NOTHING = (0.0,) * 6


@dataclass(frozen=True, eq=False)
class WaypointColumns:
    """Positions, and the frames of each row."""

    positions: Positions
    base_feature: Array  # (N, 4, 4)
    flange_tcp: Array  # (N, 4, 4)
    base_frame: dict[str, Pose]
    flange_tip: dict[str, Pose]


class _NamedFrames:
    """Frames by name; another frame of the same name gets the line where it first stands."""

    def __init__(self, xml: XmlText, frames: dict[str, tuple[float, ...]] | None = None) -> None:
        self.xml = xml
        self.frames = frames or {}
        self.counts = dict.fromkeys(self.frames, 1)
        self.keys = {(name, values): name for name, values in self.frames.items()}

    def name_all(
        self, names: Sequence[str], poses: Array, stated: Array, waypoints: Sequence[Waypoint]
    ) -> tuple[str, ...]:
        """Return every row's name of its frame."""
        values = np.round(six_of(poses, stated), 13)
        return tuple(
            self._frame_key(name, tuple(six), waypoint.offset)
            for name, six, waypoint in zip(names, values.tolist(), waypoints, strict=True)
        )

    def to_poses(self) -> dict[str, Pose]:
        """Return the frames."""
        matrices = poses_of(np.array(list(self.frames.values())).reshape(-1, 6))
        return {name: Pose.from_matrix(matrix) for name, matrix in zip(self.frames, matrices, strict=True)}

    def _frame_key(self, name: str, values: tuple[float, ...], offset: int) -> str:
        key = self.keys.get((name, values))
        if key is None:
            count = self.counts[name] = self.counts.get(name, 0) + 1
            key = name if count == 1 else f"{name} ({count}, line {self.xml.line_of(offset)})"
            self.keys[(name, values)] = key
            self.frames[key] = values
        return key


def columns_of(xml: XmlText, waypoints: Sequence[Waypoint]) -> WaypointColumns:
    """Return the columns of a program's waypoints."""
    count = len(waypoints)
    joints = np.array([w.joints.values for w in waypoints]).reshape(-1, 6)
    stored = _pose_matrices([w.pose for w in waypoints])
    base_feature = _base_features(waypoints, stored)
    flange_tcp = _tool_poses(waypoints, stored)
    computed = _flange_poses(waypoints, joints) @ flange_tcp
    base_tip = np.where(np.isnan(stored), computed, stored)
    frame_tip = inverse_transform(base_feature) @ base_tip
    has_pose = np.asarray(np.isfinite(frame_tip).all(axis=(1, 2)))
    frame_tip[~has_pose] = np.nan
    features, tools = _NamedFrames(xml, {BASE: _NOTHING}), _NamedFrames(xml)
    user_frames = features.name_all(
        [w.feature_name or BASE for w in waypoints],
        base_feature,
        _stated_sixes(waypoints, "feature"),
        waypoints,
    )
    tool_names = tools.name_all(
        [w.tool_name or "tcp" for w in waypoints], flange_tcp, _stated_sixes(waypoints, "tool"), waypoints
    )
    positions = Positions(
        names=_unique_names(xml, waypoints),
        kinds=tuple(CARTESIAN if each else JOINTS for each in has_pose.tolist()),
        lines=np.array([xml.line_of(w.offset) for w in waypoints], dtype=np.int64),
        groups=np.ones(count, dtype=np.int64),
        frame_tip=frame_tip,
        joints=joints,
        external=np.empty((count, 0)),
        # joints without a pose are in no frame
        user_frames=tuple(
            name if each else BASE for name, each in zip(user_frames, has_pose.tolist(), strict=True)
        ),
        tools=tool_names,
        configurations=("",) * count,
        resolution_m=np.full(count, DOUBLE_STEP),
        resolution_rad=np.full(count, DOUBLE_STEP),
    )
    return WaypointColumns(positions, base_feature, flange_tcp, features.to_poses(), tools.to_poses())


def _stated_sixes(waypoints: Sequence[Waypoint], which: Literal["feature", "tool"]) -> Array:
    """Return (N, 6) what waypoints say of their feature or their tool, zeros where nothing."""
    poses = [w.feature if which == "feature" else w.tool for w in waypoints]
    return np.array([_NOTHING if pose is None else pose.values for pose in poses]).reshape(-1, 6)


def _pose_matrices(sixes: Sequence[SixNumbers | None]) -> Array:
    """Return (N, 4, 4), NaN where there is none."""
    poses = np.full((len(sixes), 4, 4), np.nan)
    there = [i for i, six in enumerate(sixes) if six is not None]
    poses[there] = poses_of(np.array([six.values for six in sixes if six is not None]).reshape(-1, 6))
    return poses


def _base_features(waypoints: Sequence[Waypoint], stored: Array) -> Array:
    stated = poses_of(_stated_sixes(waypoints, "feature"))
    derived = stored @ inverse_transform(_pose_matrices([w.in_feature for w in waypoints]))
    return np.where(np.isnan(derived), stated, derived)


def _tool_poses(waypoints: Sequence[Waypoint], stored: Array) -> Array:
    stated = poses_of(_stated_sixes(waypoints, "tool"))
    derived = inverse_transform(_pose_matrices([w.flange for w in waypoints])) @ stored
    return np.where(np.isnan(derived), stated, derived)


def _flange_poses(waypoints: Sequence[Waypoint], joints: Array) -> Array:
    """Return base_flange (N, 4, 4) under each waypoint's own kinematics, NaN where they are not known."""
    flanges = np.full((len(waypoints), 4, 4), np.nan)
    groups: dict[DhChain, list[int]] = {}
    for i, waypoint in enumerate(waypoints):
        if waypoint.kinematics is not None and waypoint.kinematics.chain is not None:
            groups.setdefault(waypoint.kinematics.chain, []).append(i)
    for chain, rows in groups.items():
        flanges[rows] = chain.to_model().base_flange(joints[rows])
    return flanges


def _unique_names(xml: XmlText, waypoints: Sequence[Waypoint]) -> tuple[str, ...]:
    counts: dict[str, int] = {}
    names = []
    for waypoint in waypoints:
        count = counts[waypoint.name] = counts.get(waypoint.name, 0) + 1
        names.append(
            waypoint.name if count == 1 else f"{waypoint.name} (line {xml.line_of(waypoint.offset)}, {count})"
        )
    return tuple(names)
