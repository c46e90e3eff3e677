"""What a person should know of a URScript beside the positions that are changed: steps, computed goals, values."""

from collections.abc import Iterator, Sequence

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import Remark
from cellcal.drivers.universal_robots.program_files.script_positions import PositionFinder

_RELATIVE = ("pose_trans", "pose_add", "pose_sub", "interpolate_pose", "point_dist", "pose_inv")
_FREE = ("speedl", "speedj", "servoj", "servoc", "force_mode", "freedrive_mode", "path_offset_set")
_WIRES = ("socket_read_ascii_float", "socket_read_string", "socket_read_binary_integer", "rpc_factory", "get_var",
          "read_input_float_register", "read_port_register", "modbus_get_signal_status")  # fmt: skip
_OF_FUNCTIONS = (
    ("relative", _RELATIVE, "poses are computed from others"),
    ("computed", _FREE, "the arm moves without a recorded position"),
    ("foreign", _WIRES, "values come from elsewhere while the program runs, and may be positions"),
)
_SHOWN = 6


def list_remarks(finder: PositionFinder) -> Iterator[Remark]:
    """Yield what else holds or changes positions."""
    for code, offsets, text in _list_findings(finder):
        if offsets:
            lines = sorted({finder.line_of(offset) for offset in offsets})
            more = f" and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
            where = ", ".join(map(str, lines[:_SHOWN])) + more
            yield Remark(lines[0], code, make_message("{text} (line {where}).", text=text, where=where))


def _list_findings(finder: PositionFinder) -> Iterator[tuple[str, Sequence[int], str]]:
    """Yield the code of a remark, the offsets that it is about, and its text."""
    steps, unused = ([each.start for each in some] for some in (finder.steps, finder.unused_poses))
    yield "relative", steps, "a pose is a step from another place; it is not changed, and follows that place"
    yield "computed", unused, "a pose is given that no move goes to directly; it is not changed"
    for function in sorted({name for _, name in finder.found.computed}):
        offsets = [offset for offset, name in finder.found.computed if name == function]
        yield (
            "computed",
            offsets,
            make_message("{function} goes where the program computes", function=function),
        )
    unknown = [
        offset
        for name, uses in finder.found.uses.items()
        if not finder.is_known(name)
        for offset, role, _ in uses
        if role in ("target", "in_frame")
    ]
    yield "computed", unknown, "a move goes to a variable that holds no recorded pose, or more than that"
    for code, functions, text in _OF_FUNCTIONS:
        for function in functions:
            its_text = make_message("{function}: {text}", function=function, text=text)
            yield code, finder.found.calls.get(function, []), its_text
