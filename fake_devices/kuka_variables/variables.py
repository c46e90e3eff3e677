"""The variables of the controller as texts, and who may write them.

Imitates
    The variable access of a KUKA controller through Cross.
Source
    As controller.py.
Modelled
    The variables in the table; members in any order are accepted when written.
Not modelled
    Everything else: it does not exist.
"""

import re
from collections.abc import Callable

from cellcal.fake_devices.kuka_variables.controller import FRAMES, KukaController, values_of

_MEMBER = re.compile(r"([A-Z]\w*)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)")
_INDEXED = re.compile(r"(TOOL_DATA|BASE_DATA|LOAD_DATA|\$AXIS_CAL|\$MAMES)\[(\d+)\]")
_POSE = ("X", "Y", "Z", "A", "B", "C")


class VariableTable:
    """Texts of one controller."""

    def __init__(self, controller: KukaController) -> None:
        self._c = controller
        c = controller
        self._texts: dict[str, Callable[[], str]] = {
            "$AXIS_ACT": self._axis_text,
            "$POS_ACT": lambda: self._frame_text(
                "E6POS", values_of(c.tip_in_base()), ", S 2, T 35, E1 0.0, E2 0.0"
            ),
            "$BASE": lambda: self._frame_text("FRAME", values_of(c.base_matrix())),
            "$ROBROOT": lambda: self._frame_text("FRAME", c.root),
            "$IPO_MODE": lambda: f"#{c.ipo_mode}",
            "$TOOL": lambda: self._frame_text("FRAME", values_of(c.tool_matrix())),
            "$ACT_TOOL": lambda: str(c.tool_number),
            "$ACT_BASE": lambda: str(c.base_number),
            "$LOAD": self._load_text,
            "$MODE_OP": lambda: f"#{c.mode}",
            "$OV_PRO": lambda: str(c.override_percent),
            "$PERI_RDY": lambda: _flag_text(c.drives_on),
            "$USER_SAF": lambda: _flag_text(c.safety_closed),
            "$STOPMESS": lambda: _flag_text(c.stop_message),
            "$MODEL_NAME[]": lambda: f'"#{c.title}"',
            "$TRAFONAME[]": lambda: f'"#{c.title}"',
            "$ROBNAME[]": lambda: '"ROBOT1"',
            "$KR_SERIALNO": lambda: c.serial,
            "$PRO_STATE1": lambda: c.programs.robot.state,
        }

    def read(self, name: str) -> str | None:
        """Return a variable's text; None where there is none of this name."""
        name = name.strip().upper()
        if name in self._texts:
            return self._texts[name]()
        if (text := self._c.programs.show(name)) is not None:
            return text
        found = _INDEXED.fullmatch(name)
        return None if found is None else self._read_element(found[1], int(found[2]) - 1)

    def _read_element(self, array: str, index: int) -> str | None:
        if array in ("$AXIS_CAL", "$MAMES"):
            if not 0 <= index < 6:
                return None
            c = self._c
            return _flag_text(c.mastered[index]) if array == "$AXIS_CAL" else f"{c.mastering_deg[index]:.6g}"
        if not 0 <= index < FRAMES or array == "LOAD_DATA":
            return None
        return self._frame_text("FRAME", self._frame_table(array)[index])

    def write(self, name: str, text: str) -> bool:
        """Write a variable; return whether it may be written and the text fits."""
        name, c = name.strip().upper(), self._c
        found = _INDEXED.fullmatch(name)
        try:
            if c.programs.set_from_text(name, text):
                return True
            if name == "$OV_PRO":
                c.set_override(int(text))
            elif (
                found is not None and found[1] in ("TOOL_DATA", "BASE_DATA") and 1 <= int(found[2]) <= FRAMES
            ):
                members = dict(_MEMBER.findall(text.upper()))
                self._frame_table(found[1])[int(found[2]) - 1] = [float(members[key]) for key in _POSE]
            else:
                return False
        except (KeyError, ValueError):
            return False
        return True

    def _frame_table(self, name: str) -> list[list[float]]:
        return self._c.tools if name == "TOOL_DATA" else self._c.bases

    def _axis_text(self) -> str:
        members = ", ".join(f"{member} {value:.7g}" for member, value in self._c.shown_axes().items())
        return f"{{E6AXIS: {members}}}"

    def _frame_text(self, kind: str, values: list[float], rest: str = "") -> str:
        members = ", ".join(f"{key} {value:.6f}" for key, value in zip(_POSE, values, strict=True))
        return f"{{{kind}: {members}{rest}}}"

    def _load_text(self) -> str:
        mass = self._c.load_kg
        return f"{{M {mass}, CM {{X 0.0, Y 0.0, Z 0.0, A 0.0, B 0.0, C 0.0}}, J {{X 0.0, Y 0.0, Z 0.0}}}}"


def _flag_text(value: bool) -> str:
    return "TRUE" if value else "FALSE"
