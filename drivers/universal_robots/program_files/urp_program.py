"""A PolyScope program (``.urp``), read and changed without losing a byte of its XML."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import DhTable
from cellcal.calibration.geometry import Array, Pose, inverse_transform, is_rigid
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.programs.positions import PositionChange, Positions, ProgramFrames, Remark, with_unread
from cellcal.drivers.universal_robots.program_files.feature_variables import (
    declare_features,
    feature_of,
    features_set_elsewhere,
)
from cellcal.drivers.universal_robots.program_files.script_numbers import (
    DOUBLE_STEP,
    java_text,
    number_spans,
    six_of,
)
from cellcal.drivers.universal_robots.program_files.urp_archive import pack_file, unpack_file
from cellcal.drivers.universal_robots.program_files.urp_columns import WaypointColumns, columns_of
from cellcal.drivers.universal_robots.program_files.urp_kinematics import DhChain, joints_for, pose_distances
from cellcal.drivers.universal_robots.program_files.urp_shifts import (
    calls_others,
    features_set_by,
    shifts_of,
    unread_positions_of,
)
from cellcal.drivers.universal_robots.program_files.urp_waypoints import (
    BASE,
    SixNumbers,
    Waypoint,
    WaypointReader,
)
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

AGREES_M, AGREES_RAD = 1e-6, 1e-6
_SAME = 1e-12
_UNTOUCHED = "Nothing was changed; check what computed it."


@dataclass(frozen=True, eq=False)
class UrpProgram:
    """One ``.urp`` file. A waypoint's joints, tool and kinematics say where it is; `Positions` holds that pose."""

    file: str
    data: bytes
    header: bytes  # of gzip
    xml: XmlText
    reader: WaypointReader
    waypoints: tuple[Waypoint, ...]
    columns: WaypointColumns
    remarks: tuple[Remark, ...]
    set_elsewhere: frozenset[str] = frozenset()  # features that other programs may set

    @classmethod
    def from_bytes(cls, file: str, data: bytes) -> Self:
        """Read a file; errors as `read_urp`."""
        header, text = unpack_file(file, data)
        xml = XmlText(file, text)
        if xml.elements[0].tag != "URProgram":
            raise xml.error_at(
                xml.elements[0].offset,
                make_message("this is a {tag}, no URProgram.", tag=xml.elements[0].tag),
                "Give a program of PolyScope 3 or 5.",
            )
        reader = WaypointReader(xml)
        waypoints = list(reader.read_waypoints())
        remarks = tuple(reader.list_remarks(waypoints))
        return cls(file, data, header, xml, reader, tuple(waypoints), columns_of(xml, waypoints), remarks)

    @cached_property
    def declarations(self) -> FileDeclarations:
        """Return what counts for other files."""
        return declare_features(self._own_features, calls=calls_others(self.reader))

    def with_external_uses(self, external_uses: ExternalUses) -> Self:
        """Return the program with the features that others set."""
        names = {feature_of(waypoint.feature_name) for waypoint in self.waypoints}
        found = features_set_elsewhere(external_uses, names, calls=calls_others(self.reader))
        return replace(self, set_elsewhere=found) if found else self

    @cached_property
    def _own_features(self) -> frozenset[str]:
        return features_set_by(self.xml, self.reader)

    @property
    def brand(self) -> str:
        """Return the brand's package name."""
        return "universal_robots"

    @property
    def name(self) -> str:
        """Return the program's own name."""
        return self.xml.attribute_value(0, "name") or self.file

    @property
    def positions(self) -> Positions:
        """Return every fixed waypoint, and what else holds a position."""
        return self._all_positions

    @cached_property
    def _all_positions(self) -> Positions:
        found = with_unread(self.columns.positions, unread_positions_of(self.xml, self.reader))
        in_variables = self._own_features | self.set_elsewhere
        turned = {
            row: COMPUTED
            for row, waypoint in enumerate(self.waypoints)
            if feature_of(waypoint.feature_name) in in_variables
        }
        return replace(found, shifts=shifts_of(self.xml, self.reader), barred={**turned, **found.barred})

    @cached_property
    def frames(self) -> ProgramFrames:
        """Return the tools and features of the waypoints, and the kinematics of the arm the program was saved on."""
        own = self.reader.own.chain if self.reader.own else None
        base = {BASE: Pose((0.0, 0.0, 0.0)), **self.columns.base_frame}
        return ProgramFrames(base, self.columns.flange_tip, own.to_model() if own else None)

    def to_bytes(self) -> bytes:
        """Return the file."""
        return self.data

    def poses_at(self, rows: NDArray[np.int64], joints: Array) -> Array:
        """Return frame_tip (K, 4, 4) that joints (K, 6) mean under each waypoint's own kinematics; NaN if unknown."""
        flange = np.full((len(rows), 4, 4), np.nan)
        for chain, which in self._by_chain(rows):
            if chain is not None:
                flange[which] = chain.to_model().base_flange(joints[which])
        poses: Array = (
            inverse_transform(self.columns.base_feature[rows]) @ flange @ self.columns.flange_tcp[rows]
        )
        return poses

    def with_changes(self, change: PositionChange) -> Self:
        """Return the program with new joints; from poses these are derived, nearest to the present ones.

        Poses and joints that are both given must agree under the waypoint's own kinematics.

        Raises
        ------
        ProgramFileError
            A pose where the kinematics are not known, out of reach, or not that of the joints.
        """
        if change.configurations is not None or change.user_frames is not None:
            raise self._refused_error(
                "a waypoint holds no configuration and no frame number.", "Give poses and joints only."
            )
        rows = np.asarray(change.rows, dtype=np.int64)
        pose = (
            np.full((len(rows), 4, 4), np.nan)
            if change.frame_tip is None
            else np.array(change.frame_tip, dtype=float)
        )
        joints = (
            np.full((len(rows), 6), np.nan) if change.joints is None else np.array(change.joints, dtype=float)
        )
        with_pose, with_joints = ~np.isnan(pose).all(axis=(1, 2)), ~np.isnan(joints).all(axis=1)
        if with_pose.any() and not is_rigid(pose[with_pose]):
            raise self._refused_error("a new pose is no rigid transform.", _UNTOUCHED)
        if not np.isfinite(joints[with_joints]).all():
            raise self._refused_error("a new joint angle is not finite.", _UNTOUCHED)
        only_pose, both = with_pose & ~with_joints, with_pose & with_joints
        joints[only_pose] = self._solve_joints(rows[only_pose], pose[only_pose])
        self._check_agreement(rows[both], pose[both], joints[both])
        only_joints = with_joints & ~with_pose
        pose[only_joints] = self.poses_at(rows[only_joints], joints[only_joints])
        is_given = with_pose | with_joints
        edits = XmlEdits(self.file, self.xml)
        edits.write_waypoints(self, rows[is_given], pose[is_given], joints[is_given])
        return self._with_edits(edits)

    def with_kinematics(self, table: DhTable, checksum: Sequence[int], *, keep_poses: bool) -> Self:
        """Return the program with another arm's factory kinematics at every waypoint that has known ones.

        Parameters
        ----------
        table : DhTable
            Absolute standard DH of the other arm (six rows), from its calibration file or its primary interface.
        checksum : six ints
            Its joint checksums.
        keep_poses : bool
            True derives new joints, so that every pose stays; False keeps the joints, and the poses move.

        Raises
        ------
        ProgramFileError
            No table of six plain rows, or a pose that the other arm does not reach.
        """
        numbers = table.to_rows()
        if (
            numbers.shape != (6, 5)
            or not np.isfinite(numbers).all()
            or numbers[:, 4].any()
            or len(checksum) != 6
        ):
            raise self._refused_error(
                "kinematics are six rows of standard DH and six checksums.", "Read them from the robot."
            )
        signed = [(int(value) + 2**31) % 2**32 - 2**31 for value in checksum]
        edits = XmlEdits(self.file, self.xml)
        for kinematics in self.reader.kinematics.values():
            if kinematics.chain is None:
                continue
            for six, column in zip(kinematics.columns, (0, 2, 1, 3), strict=True):
                edits.write_texts(six, [java_text(float(value)) for value in numbers[:, column]])
            if kinematics.checksum is not None:
                edits.write_texts(kinematics.checksum, [str(value) for value in signed])
        moved = self._with_edits(edits)
        if not keep_poses:
            return moved
        known_rows = np.flatnonzero(np.isfinite(self.positions.frame_tip).all(axis=(1, 2)))
        return moved.with_changes(PositionChange(known_rows, frame_tip=self.positions.frame_tip[known_rows]))

    def _solve_joints(self, rows: NDArray[np.int64], pose: Array) -> Array:
        """Return joints (K, 6) for poses; those of a waypoint whose pose stays are kept."""
        now = self.positions.joints[rows]
        joints = now.copy()
        flange = self.columns.base_feature[rows] @ pose @ inverse_transform(self.columns.flange_tcp[rows])
        off = np.abs(self.poses_at(rows, now) - pose).reshape(len(rows), 16)
        stays = np.asarray(off.max(axis=1, initial=0.0) <= _SAME, dtype=bool)
        for chain, which in self._by_chain(rows):
            if chain is None and not stays[which].all():
                raise self._refused_error(
                    make_message(
                        "{row_names}: the kinematics of the arm are not known.",
                        row_names=self._row_names(rows[which][~stays[which]]),
                    ),
                    "Give joints, or open and save the program on its robot first.",
                )
            if chain is not None:
                joints[which], reached = joints_for(chain.to_model(), flange[which], now[which])
                if not reached.all():
                    raise self._refused_error(
                        make_message(
                            "{row_names}: out of reach of the arm.",
                            row_names=self._row_names(rows[which][~reached]),
                        ),
                        "Leave these waypoints out, or move the work piece nearer.",
                    )
        joints[stays] = now[stays]
        return joints

    def _check_agreement(self, rows: NDArray[np.int64], pose: Array, joints: Array) -> None:
        means = self.poses_at(rows, joints)
        far, turned = pose_distances(means, pose)
        has_kinematics = ~np.isnan(means[:, 0, 0])
        stored = np.array([self.waypoints[row].pose is not None for row in rows], dtype=bool)
        wrong = np.where(has_kinematics, ~((far <= AGREES_M) & (turned <= AGREES_RAD)), ~stored)
        if wrong.any():
            worst = float(np.nanmax(np.where(has_kinematics, far, 0.0))) * 1e3
            raise self._refused_error(
                make_message(
                    "{row_names}: pose and joints do not agree under the waypoint's own kinematics "
                    "({worst:.4f} mm).",
                    row_names=self._row_names(rows[wrong]),
                    worst=worst,
                ),
                "Give joints only, or first give the program the kinematics of the robot it is for.",
            )

    def _by_chain(self, rows: NDArray[np.int64]) -> list[tuple[DhChain | None, NDArray[np.intp]]]:
        groups: dict[DhChain | None, list[int]] = {}
        for place, row in enumerate(rows.tolist()):
            kinematics = self.waypoints[row].kinematics
            groups.setdefault(kinematics.chain if kinematics else None, []).append(place)
        return [(chain, np.array(which, dtype=np.intp)) for chain, which in groups.items()]

    def _with_edits(self, edits: "XmlEdits") -> Self:
        text = edits.edited_text()
        if text == self.xml.text:
            return self
        return type(self).from_bytes(self.file, pack_file(self.header, text.encode("latin-1")))

    def _row_names(self, rows: NDArray[np.int64]) -> str:
        names = [self.positions.names[row] for row in rows[:5]]
        return ", ".join(names) + (f" and {len(rows) - 5} more" if len(rows) > 5 else "")

    def _refused_error(self, what: str, cure: str) -> ProgramFileError:
        return ProgramFileError(self.file, what, remedy=cure)


class XmlEdits:
    """New texts for numbers of the XML."""

    def __init__(self, file: str, xml: XmlText) -> None:
        self.file = file
        self.xml = xml
        self.spans: list[tuple[int, int, str]] = []

    def write_waypoints(
        self, program: UrpProgram, rows: NDArray[np.int64], pose: Array, joints: Array
    ) -> None:
        """Write joints, and the poses that the waypoints store."""
        base_tip = program.columns.base_feature[rows] @ pose
        flange = base_tip @ inverse_transform(program.columns.flange_tcp[rows])
        for i, row in enumerate(rows.tolist()):
            waypoint = program.waypoints[row]
            if not np.isnan(joints[i]).any():
                self._replace_numbers(waypoint.joints, joints[i])
            stored = (
                (waypoint.pose, base_tip[i]),
                (waypoint.in_feature, pose[i]),
                (waypoint.flange, flange[i]),
            )
            for six, matrix in stored:
                if six is not None:
                    self._put_pose(six, matrix, waypoint)

    def write_texts(self, six: SixNumbers, texts: list[str]) -> None:
        """Write these texts."""
        spans = number_spans(self.xml.text, six.start, six.end)
        self.spans += [(*span, text) for span, text in zip(spans, texts, strict=True)]

    def edited_text(self) -> str:
        """Return the whole XML, changed."""
        pieces, at = [], 0
        for start, end, new in sorted(self.spans):
            pieces += [self.xml.text[at:start], new]
            at = end
        return "".join([*pieces, self.xml.text[at:]])

    def _put_pose(self, six: SixNumbers, matrix: Array, waypoint: Waypoint) -> None:
        if np.isnan(matrix).any():
            raise self.xml.error_at(
                six.start,
                make_message(
                    "{waypoint_name} stores a pose, and was given joints only.", waypoint_name=waypoint.name
                ),
                "Give both: the kinematics are unknown.",
            )
        self._replace_numbers(six, six_of(matrix[None], np.array([six.values]))[0])

    def _replace_numbers(self, six: SixNumbers, values: Array) -> None:
        old = [self.xml.text[start:end] for start, end in number_spans(self.xml.text, six.start, six.end)]
        new = [
            text if abs(value - float(text)) <= DOUBLE_STEP else java_text(value)
            for text, value in zip(old, values.tolist(), strict=True)
        ]
        self.write_texts(six, new)


def read_urp(name: str, data: bytes) -> UrpProgram:
    """Read a ``.urp`` file.

    Raises
    ------
    ProgramFileError
        No gzip, a bomb, XML that is damaged or asks for more than text, numbers that are no coordinates.
    """
    return UrpProgram.from_bytes(name, data)
