"""``python -m tests.unit.helpers.reference_problems``: draw the reference problems' inputs and write the files."""

import json
import random
from pathlib import Path

import mpmath as mp

from tests.unit.helpers.reference_solver import (
    DIGITS,
    answer_problem,
    flange_pose,
    to_column,
    translation_matrix,
    turn_x,
    turn_y,
    turn_z,
    unit_vector,
)

FOLDER = Path(__file__).resolve().parents[3] / "calibration" / "reference_data"

_UR10 = [  # published nominal table: theta, d, a, alpha, beta
    [0, "0.1273", 0, "1.5707963267948966", 0],
    [0, 0, "-0.612", 0, 0],
    [0, 0, "-0.5723", 0, 0],
    [0, "0.163941", 0, "1.5707963267948966", 0],
    [0, "0.1157", 0, "-1.5707963267948966", 0],
    [0, "0.0922", 0, 0, 0],
]


def _draw_inputs():
    """Inputs with few digits, so that a file holds exactly what a double holds nearly."""
    rng = random.Random(20261121)

    def draw_near(scale, digits=6):
        return round(rng.uniform(-scale, scale), digits)

    def draw_points(count, scale):
        return [[draw_near(scale) for _ in range(3)] for _ in range(count)]

    source = draw_points(8, 1.0)
    turned = (
        turn_z(mp.mpf("0.7"))
        * turn_y(mp.mpf("-1.1"))
        * turn_x(mp.mpf("2.3"))
        * translation_matrix(1, -2, mp.mpf("0.5"))
    )
    target = []
    for point in source:
        moved = turned * mp.matrix([*map(mp.mpf, point), 1])
        target.append([round(float(moved[i]) + draw_near(5e-4), 7) for i in range(3)])
    tip, pin = mp.matrix(["0.031", "-0.012", "0.204"]), mp.matrix(["0.8", "0.1", "0.3"])
    touches = []
    for _ in range(6):
        attitude = (
            turn_z(mp.mpf(draw_near(3))) * turn_y(mp.mpf(draw_near(0.8))) * turn_x(mp.mpf(draw_near(0.8)))
        )
        place = pin - attitude[:3, :3] * tip
        for i in range(3):
            attitude[i, 3] = mp.mpf(round(float(place[i]) + draw_near(2e-4), 7))
        touches.append([[mp.nstr(attitude[i, j], 20) for j in range(4)] for i in range(4)])
    real = [
        [draw_near(5e-3), str(mp.mpf(str(row[1])) + draw_near(8e-4)), str(mp.mpf(str(row[2])) + draw_near(8e-4)),
         str(mp.mpf(str(row[3])) + draw_near(1e-3)), draw_near(1e-3)]
        for row in _UR10
    ]  # fmt: skip
    postures = [
        [0.4, -1.2, 1.3, -1.3, 1.2, 0.3],
        [-2.1, -0.7, -1.6, 0.4, -1.4, 2.9],
        [1.1, -2.2, 0.9, 2.5, 0.8, -1.7],
    ]
    wide = [[draw_near(3), draw_near(0.5), draw_near(0.5), draw_near(3), draw_near(0.5)] for _ in range(6)]
    nominal_frames = {name: _draw_attitude(draw_near) for name in (
        "base_frame", "base_frame_moved", "frame_tcp", "other_base_frame", "base_fixture", "other_base_fixture"
    )}  # fmt: skip
    return {
        "plane": _plane_drawn(draw_near),
        "frame": {
            "three_points_m": [[0.812, -0.305, 0.11], [1.307, 0.048, 0.133], [0.55, 0.266, 0.092]],
            "six_points_m": [
                [0.9, 0.1, 0.205], [1.2, 0.15, 0.21], [1.0, 0.5, 0.195],
                [0.85, 0.02, 0.16], [1.25, 0.07, 0.17], [0.801, 0.3, 0.18], [1.0, 0.2, 0.6],
            ],
            **nominal_frames,
        },
        "registration": {"source_m": source, "target_m": target},
        "tool_point": {"touches": touches},
        "dh": {"rows": wide, "joints_rad": postures},
        "compensation": {"nominal": _UR10, "real": real, "joints_rad": postures},
        "turn_loss": _turn_loss_drawn(draw_near),
        "fixture": _fixture_drawn(draw_near),
    }  # fmt: skip


def _draw_attitude(near):
    place = translation_matrix(mp.mpf(near(1.5)), mp.mpf(near(1.5)), mp.mpf(near(1.0)))
    place = place * turn_z(mp.mpf(near(3))) * turn_y(mp.mpf(near(1))) * turn_x(mp.mpf(near(1)))
    return [[mp.nstr(place[i, j], 20) for j in range(4)] for i in range(4)]


def _plane_drawn(near):
    """Postures whose tip is on a tilted plane but for tenths of a millimetre: joint 3 brings it there."""
    tool, joints = mp.matrix(["0.031", "-0.012", "0.204", 1]), []
    normal = unit_vector(to_column([0.05, -0.08, 1]))
    while len(joints) < 12:
        posture = [near(2.5), -1.2 + near(0.3), 1.7 + near(0.3), -2.0 + near(0.5), near(1.4), near(2.5)]

        def plane_height(third, posture=posture):
            tip = flange_pose(_UR10, [*posture[:2], third, *posture[3:]]) * tool
            return (normal.T * tip[:3])[0] - mp.mpf("-0.1")

        try:
            posture[2] = round(float(mp.findroot(plane_height, posture[2])) + near(3e-4), 6)
        except ValueError:
            continue  # out of reach
        joints.append([round(value, 6) for value in posture])
    return {
        "rows": _UR10,
        "base": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        "tip_in_flange_m": ["0.031", "-0.012", "0.204"],
        "joints_rad": joints,
        "sigma_m": 2e-4,
        "above_m": [0.7, 0.2, 0.5],
    }


def _turn_loss_drawn(near):
    """Ten lengths, of motors that move the tip by a few centimetres a turn; noise that leaves the turns in doubt."""
    rows = [[near(0.04, 5) for _ in range(6)] for _ in range(10)]
    for row in rows:
        row[2] = round(row[1] + near(0.0015, 5), 5)  # two motors that act alike, as shoulder and elbow do
    turns = [3, -7, 12, 0, -2, 5]
    lengths = [round(sum(a * z for a, z in zip(row, turns, strict=True)) + near(8e-3, 6), 6) for row in rows]
    return {"metres_per_turn_m": rows, "lengths_m": lengths, "sigma_m": 4e-3}


def _fixture_drawn(near):
    stations = [
        [round(x + near(0.05), 4), round(y + near(0.05), 4), round(z + near(0.05), 4)]
        for x, y, z in ((0.6, -0.5, 0.3), (0.7, 0.5, 0.4), (0.4, 0.0, 0.9), (1.1, 0.1, 0.7), (0.8, -0.2, 1.1))
    ]
    drawing = [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.3, 0.05], [0.0, 0.3, 0.1]]
    pose = (
        translation_matrix(1, mp.mpf("-0.2"), mp.mpf("-0.15"))
        * turn_z(mp.mpf("0.4"))
        * turn_x(mp.mpf("0.05"))
    )
    lengths = []
    for point in drawing:
        place = pose * mp.matrix([*map(mp.mpf, point), 1])
        lengths.append([round(float(mp.norm(place[:3] - to_column(s))) + near(2e-4), 6) for s in stations])
    return {"stations_m": stations, "lengths_m": lengths, "drawing_m": drawing}


_TITLES = {
    "plane": "Plane through twelve touches with a known tip",
    "frame": "Frames on three points and on 3-2-1 points, moved frames, one robot's base in another's",
    "registration": "Best-fit rigid transform of eight noisy points",
    "tool_point": "Tool tip and pin from six noisy touches",
    "dh": "Flange of a DH chain with beta, at three postures",
    "compensation": "Joints of an arm with errors that reach the nominal arm's flange",
    "turn_loss": "Whole turns that six motors lost, from ten lengths: nearest and next nearest",
    "fixture": "Four alignment points by their lengths from five stations, and the fixture on them",
}
_TOLERANCES = {
    "plane": 1e-12,
    "frame": 1e-13,
    "registration": 1e-12,
    "tool_point": 1e-12,
    "dh": 1e-13,
    "compensation": 1e-8,
    "turn_loss": 1e-10,
    "fixture": 1e-9,
}


def write_problems():
    """Draw the inputs and write every file."""
    with mp.workdps(DIGITS):
        drawn = _draw_inputs()
    for name, inputs in drawn.items():
        document = {
            "title": _TITLES[name],
            "solver": f"tests/unit/helpers/reference_solver.py, mpmath, {DIGITS} digits",
            "tolerance": _TOLERANCES[name],
            "given": inputs,
            "answers": answer_problem(name, inputs),
        }
        text = json.dumps(document, indent=1) + "\n"
        (FOLDER / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_problems()
