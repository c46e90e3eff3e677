"""Points that a URScript program brings into a frame before it moves there: ``over = pose_trans(plane, p[...])``."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from cellcal.drivers.universal_robots.program_files.script_calls import Role
from cellcal.drivers.universal_robots.program_files.script_text import SIX_OVER_LINES, ScriptStatements

_B = r"[ \t]*+"
_ASSIGNED = re.compile(
    rf"^{_B}(?:(?:global|local)[ \t]++)?+(?P<to>[A-Za-z_]\w*+){_B}={_B}pose_trans{_B}\({_B}"
    rf"(?P<frame>[A-Za-z_]\w*+){_B},{_B}(?:(?P<name>[A-Za-z_]\w*+)|p\[(?P<six>{SIX_OVER_LINES})\]){_B}\){_B}"
    r"(?:#[^\r\n]*+)?\r?$",
    re.ASCII | re.MULTILINE,
)


def settle_assigned_frames(found: ScriptStatements, text: str) -> Mapping[int, tuple[int, ...]]:
    """Take poses that are brought into a frame and gone to by another name as positions in that frame.

    Return by where a literal begins the offsets of the moves to it. What counts is a name that a move goes to, a
    frame that a variable holds and nothing else, and a pose that is written out so or in the call.
    """
    assigned = list(_ASSIGNED.finditer(text))
    moves = {one["to"]: _moves_to(found, one["to"]) for one in assigned}
    for one in reversed(assigned):  # a move to a place that is computed from another one needs that, too
        if one["frame"] in moves:
            moves[one["frame"]] += moves[one["to"]]
    constants = _constant_poses(found) if any(moves.values()) else frozenset()
    by_start = {literal.start: row for row, literal in enumerate(found.literals)} if constants else {}
    offsets: dict[int, tuple[int, ...]] = {}
    for one in assigned:
        at = moves[one["to"]]
        if not at or one["frame"] not in constants or not (one["six"] or one["name"] in constants):
            continue
        _replace_use(found, one, "frame", [one.start("frame")], ("frame", "pose_trans"))
        if one["name"]:
            _replace_use(found, one, "name", at, ("in_frame", one["frame"]))
        else:
            row = by_start[one.start("six")]
            found.literals[row] = found.literals[row]._replace(role="in_frame", name=one["frame"])
            offsets[one.start("six")] = at
    return offsets


def _moves_to(found: ScriptStatements, name: str) -> tuple[int, ...]:
    return tuple(at for at, role, _ in found.uses.get(name, ()) if role == "target")


def _constant_poses(found: ScriptStatements) -> frozenset[str]:
    """Return the variables that hold one pose that is written out, and nothing else."""
    counts = Counter(
        literal.name for literal in found.literals if literal.role == "value" and literal.is_pose
    )
    changed = found.assigned.keys() | {one.name for one in found.elements}
    return frozenset(name for name, count in counts.items() if count == 1 and name not in changed)


def _replace_use(
    found: ScriptStatements,
    one: re.Match[str],
    group: str,
    offsets: Sequence[int],
    role: tuple[Role, str],
) -> None:
    """Say that a name, where it stands in the call, has another role, at the offsets of the moves."""
    others = [use for use in found.uses.get(one[group], ()) if use[0] != one.start(group)]
    found.uses[one[group]] = [*others, *((at, *role) for at in offsets)]
