"""Tools and frames that files of a batch declare for all others."""

from collections import defaultdict
from collections.abc import Mapping, Set
from dataclasses import replace
from itertools import takewhile
from pathlib import PurePath
from typing import TypeAlias

from cellcal.calibration.geometry import Pose
from cellcal.drivers.programs.positions import Positions, ProgramFrames

Poses: TypeAlias = Mapping[str, Pose | None]  # by name, in the language's one case; None: no fixed pose


class DeclaredPoses:
    """Poses by the files that declare them, of several with one name the nearest file's for each.

    Robots' backups lie in folders side by side, and each has its own tool 1.
    """

    def __init__(self, declared: Mapping[str, Poses]) -> None:
        self._declared = [(PurePath(file).parent, poses) for file, poses in declared.items()]
        self._poses_by_folder: dict[str, Poses] = {}

    def poses_visible_from(self, folder: str) -> Poses:
        """Return the poses that a folder's files use; None where equally near declarations differ."""
        if folder not in self._poses_by_folder:
            found: dict[str, dict[tuple[int, int], set[Pose | None]]] = defaultdict(lambda: defaultdict(set))
            for place, poses in self._declared:
                near = _folder_nearness(PurePath(folder), place)
                for name, pose in poses.items():
                    found[name][near].add(pose)
            nearest = {name: by_near[max(by_near)] for name, by_near in found.items()}
            self._poses_by_folder[folder] = {
                name: next(iter(poses)) if len(poses) == 1 else None for name, poses in nearest.items()
            }
        return self._poses_by_folder[folder]


def with_declared(
    frames: ProgramFrames, positions: Positions, tools: Poses, bases: Poses, *, own: Set[str]
) -> ProgramFrames:
    """Return a file's frames with those that its positions name and other files of its cell declare.

    ``own`` are names that the file itself declares, in the language's one case.
    """
    return replace(
        frames,
        cell_flange_tip=_find_poses({*positions.tools} - frames.flange_tip.keys(), tools, own),
        cell_base_frame=_find_poses({*positions.user_frames} - frames.base_frame.keys(), bases, own),
    )


def _find_poses(names: Set[str | None], declared: Poses, own: Set[str]) -> dict[str, Pose]:
    found = {
        name: declared.get(name.lower()) for name in names if name is not None and name.lower() not in own
    }
    return {name: pose for name, pose in found.items() if pose is not None}


def _folder_nearness(folder: PurePath, other: PurePath) -> tuple[int, int]:
    """Return how many folders two of them share from the top, and how many the other is below these."""
    common = sum(
        1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(folder.parts, other.parts, strict=False))
    )
    return common, common - len(other.parts)
