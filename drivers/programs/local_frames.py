"""Tools and frames that only one file of a batch sees, and with which it goes to positions of others."""

from collections import defaultdict
from collections.abc import Mapping
from pathlib import PurePath

from cellcal.calibration.geometry import Pose
from cellcal.drivers.programs.barred import ONLY_SEEN_THERE
from cellcal.drivers.programs.declared_poses import DeclaredPoses, Poses
from cellcal.drivers.programs.file_declarations import FileDeclarations, MoveFrames, lower_name


class LocalFrames:
    """The tools and frames that each file declares for itself, next to those of all files."""

    def __init__(self, declarations: Mapping[str, FileDeclarations]) -> None:
        self._by_file = declarations
        every = [(file, one) for file, one in declarations.items() if _declares_any(one)]
        self._all_tools = DeclaredPoses({file: {**one.tools, **one.local_tools} for file, one in every})
        self._all_bases = DeclaredPoses({file: {**one.bases, **one.local_bases} for file, one in every})
        self._tools: dict[str, dict[str, Pose]] = defaultdict(dict)  # by the file whose positions need them
        self._bases: dict[str, dict[str, Pose]] = defaultdict(dict)

    def seen_from(self, owner: str, use: MoveFrames, file: str) -> MoveFrames:
        """Return a use by a file of an owner's position; without tool and frame where the name is several's.

        A name that no file beside the owner declares otherwise means what the using file says.
        """
        if use.why != ONLY_SEEN_THERE:
            return use
        one, folder = self._by_file[file], str(PurePath(owner).parent)
        tool, frame = lower_name(use.tool), lower_name(use.frame)
        tools = _local_pose(one.local_tools, tool, self._all_tools, folder)
        bases = _local_pose(one.local_bases, frame, self._all_bases, folder)
        if tools is None or bases is None:
            return use._replace(tool=None, frame=None)
        self._tools[owner] |= tools
        self._bases[owner] |= bases
        return use._replace(why="")

    def with_local(self, file: str, tools: Poses, bases: Poses) -> tuple[Poses, Poses]:
        """Return the poses that a file sees with those that uses of its positions bring."""
        return {**tools, **self._tools.get(file, {})}, {**bases, **self._bases.get(file, {})}


def _local_pose(own: Poses, name: str, every: DeclaredPoses, folder: str) -> dict[str, Pose] | None:
    """Return a local name's pose; nothing for a name that is not local, None where it has no single pose."""
    if name not in own:
        return {}
    pose = own[name]
    return None if pose is None or every.poses_visible_from(folder).get(name) != pose else {name: pose}


def _declares_any(one: FileDeclarations) -> bool:
    return any((one.tools, one.bases, one.local_tools, one.local_bases))
