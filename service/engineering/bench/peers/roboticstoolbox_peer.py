"""roboticstoolbox: its C++ Levenberg-Marquardt, ``ik_LM``, from the nominal joints, one posture at a time."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TOLERANCE = 1e-14  # half the squared error [m^2, rad^2]; with its default of 1e-6 it stops at tenths of a mm


def compensate(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Search from the joints given, once: a second search would begin at random joints."""
    toolbox = import_module("roboticstoolbox")
    nominal, real = (_build_chain(toolbox, inputs[f"{name}_placements"]) for name in ("nominal", "real"))
    joints = inputs["joints"]

    def solve_postures() -> tuple[Any, Any]:
        found, claimed = np.empty_like(joints), np.zeros(len(joints), dtype=bool)
        for i, start in enumerate(joints):
            answer = real.ik_LM(
                nominal.eval(start), q0=start, ilimit=30, slimit=1, tol=_TOLERANCE, joint_limits=False
            )
            found[i], claimed[i] = answer.q, answer.success
        return found, claimed

    seconds, (found, claimed) = measure(solve_postures)
    return {"joints": found, "seconds": seconds, "claimed": claimed}


def _build_chain(toolbox: Any, placements: Any) -> Any:
    chain = toolbox.ET.SE3(placements[0])
    for placement in placements[1:]:
        chain = chain * toolbox.ET.Rz() * toolbox.ET.SE3(placement)
    return chain
