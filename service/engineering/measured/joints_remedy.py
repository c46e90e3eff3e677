"""What helps where a file holds no columns of joints."""

from collections.abc import Mapping, Sequence

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.column_words import find_triples
from cellcal.service.engineering.measured.table_heads import are_numbered

_REPORT_WORDS = {"nominal", "meas", "dev"}  # over the axes of a CMM's report


def joints_remedy(
    names: Sequence[str], plain: Mapping[str, str], joint_names: Sequence[str], *, some_joints: bool
) -> str:
    """Return what helps where joints are missing: what the file is tells what it can be used for.

    ``names`` are columns of numbers, as far as that is known; ``some_joints`` says that some are
    called as joints are.
    """
    count = len(joint_names)
    present = {plain[name].casefold() for name in plain}
    missing = [joint for joint in joint_names if joint.casefold() not in present]
    if count > 2 and len(missing) == 1:
        return make_message(
            "Only {joint} is missing: if another column holds it, call that column {joint}; where it never moves (a "
            "wrist that rods keep level, a locked axis), add a column {joint} of zeros.",
            joint=missing[0],
        )
    numbered = are_numbered(list(plain))
    if find_triples(names, plain, "xyz") and len(names) < count + 3 and not some_joints:
        return (
            "This is a list of points without the joints of the robot: `cellcal simulate-cell` reads such files; "
            "for an identification every row needs the joints, too. If they stand in another file, name it: "
            "`--joints FILE`, or on a page “Joints in another file”."
        )
    if {word for name in plain for word in plain[name].split("_")} >= _REPORT_WORDS and not some_joints:
        return (
            "This is a report with one axis a line. Export one row a point, with X, Y, Z side by side and the joints "
            "of the robot beside them. If they stand in another file, name it: `--joints FILE`, or on a page “Joints "
            "in another file”."
        )
    if numbered and len(names) <= count:
        return make_message(
            "It has {columns} columns of numbers without a heading: too few for the {count} joints and what the "
            "device read, which every row needs. Where joints and readings are two files, name that of the joints: "
            "`--joints FILE`, or on a page “Joints in another file”. Lists of points alone are "
            "read by `cellcal simulate-cell`.",
            columns=len(names),
            count=count,
        )
    if numbered:
        at = [list(plain).index(name) + 1 for name in names]
        joints = ",".join(map(str, at[:count]))
        reading = f"position={','.join(map(str, at[count : count + 3]))}"
        if len(names) < count + 3:
            reading = f"length={at[count]}"
        return (
            f"It has no heading: say which columns are which by their numbers, such as `--columns joints={joints}` "
            f"`--columns {reading}`."
        )
    return make_message(
        "Name the columns of its joints ({joints}) in this order: `--columns joints=q1,q2,…` (or by their numbers), "
        "and check --robot.",
        joints=", ".join(joint_names),
    )
