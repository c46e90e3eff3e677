"""Answers to the reference problems with fifty digits and none of the product's code: mpmath and elementary steps.

``python -m tests.unit.helpers.reference_solver`` draws the inputs anew and writes the files.
"""

import json
import random
from pathlib import Path

import mpmath as mp

FOLDER = Path(__file__).resolve().parents[3] / "calibration" / "reference_data"
DIGITS = 50
SHOWN = 25


def matrix(rows):
    return mp.matrix([[mp.mpf(str(v)) for v in row] for row in rows])


def column(values):
    return mp.matrix([mp.mpf(str(v)) for v in values])


def turn_z(angle):
    c, s = mp.cos(angle), mp.sin(angle)
    return mp.matrix([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def turn_x(angle):
    c, s = mp.cos(angle), mp.sin(angle)
    return mp.matrix([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def turn_y(angle):
    c, s = mp.cos(angle), mp.sin(angle)
    return mp.matrix([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])


def shift(x, y, z):
    moved = mp.eye(4)
    moved[0, 3], moved[1, 3], moved[2, 3] = x, y, z
    return moved


def flange(rows, joints):
    """Rows theta, d, a, alpha, beta as numbers or decimal strings; the joint adds to theta."""
    place = mp.eye(4)
    for row, joint in zip(rows, joints, strict=True):
        theta, d, a, alpha, beta = (mp.mpf(str(v)) for v in row)
        place = place * turn_z(theta + mp.mpf(joint)) * shift(0, 0, d) * shift(a, 0, 0)
        place = place * turn_x(alpha) * turn_y(beta)
    return place


def cross(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit(a):
    return a / mp.norm(a)


def frame(x, y, z, origin):
    result = mp.eye(4)
    for j, axis in enumerate((x, y, z, origin)):
        for i in range(3):
            result[i, j] = axis[i]
    return result


def three_point_frame(points):
    origin, on_x, on_xy = (column(p) for p in points)
    x = unit(on_x - origin)
    # Gram-Schmidt on the second direction: the product's way is two cross products.
    side = on_xy - origin
    y = unit(side - x * (x.T * side)[0])
    return frame(x, y, cross(x, y), origin)


def six_point_frame(points):
    """Cramer's rule on the three planes; the last point lies above."""
    p = [column(each) for each in points]
    z = unit(cross(p[1] - p[0], p[2] - p[0]))
    if (z.T * (p[6] - p[0]))[0] < 0:
        z = -z
    y = unit(cross(z, p[4] - p[3]))
    x = cross(y, z)
    normals = mp.matrix([[axis[i] for i in range(3)] for axis in (x, y, z)])
    right = mp.matrix([(x.T * p[5])[0], (y.T * p[3])[0], (z.T * p[0])[0]])
    origin = mp.lu_solve(normals, right)
    return frame(x, y, z, origin)


def best_fit(source, target):
    """B. K. P. Horn, Closed-form solution of absolute orientation using unit quaternions, JOSA A 4 (1987) 629."""
    n = len(source)
    a, b = [column(p) for p in source], [column(p) for p in target]
    mean_a, mean_b = (sum(points[1:], points[0]) / n for points in (a, b))
    s = mp.zeros(3)
    for p, q in zip(a, b, strict=True):
        s += (p - mean_a) * (q - mean_b).T
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = ([s[i, j] for j in range(3)] for i in range(3))
    symmetric = mp.matrix([
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ])  # fmt: skip
    _, vectors = mp.eigsy(symmetric)
    w, x, y, z = (vectors[i, 3] for i in range(4))  # the largest eigenvalue comes last
    rotation = mp.matrix([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])  # fmt: skip
    origin = mean_b - rotation * mean_a
    squares = sum(mp.norm(rotation * p + origin - q) ** 2 for p, q in zip(a, b, strict=True))
    axes = [rotation[:, j] for j in range(3)]
    return frame(*axes, origin), mp.sqrt(squares / (3 * n))


def tool_point(touches):
    """Tip and pin by the normal equations of R t - q = -p."""
    normal, right = mp.zeros(6), mp.zeros(6, 1)
    for touch in touches:
        place = matrix(touch)
        rows = mp.zeros(3, 6)
        for i in range(3):
            for j in range(3):
                rows[i, j] = place[i, j]
            rows[i, 3 + i] = -1
        normal += rows.T * rows
        right += rows.T * -place[:3, 3]
    answer = mp.lu_solve(normal, right)
    squares = mp.mpf(0)
    for touch in touches:
        place = matrix(touch)
        tip = place[:3, :3] * answer[:3] + place[:3, 3] - answer[3:6]
        squares += mp.norm(tip) ** 2
    return answer, mp.sqrt(squares / (3 * len(touches)))


def compensated(nominal, real, joints):
    """Newton on place and the off-diagonal differences of the two attitudes, derivatives by differences."""
    wanted = flange(nominal, joints)
    found = column(joints)
    for _ in range(8):
        gap = _gap(wanted, flange(real, found))
        slopes, step = mp.zeros(6), mp.mpf(10) ** -20
        for k in range(6):
            moved = found.copy()
            moved[k] += step
            change = (_gap(wanted, flange(real, moved)) - gap) / step
            for i in range(6):
                slopes[i, k] = change[i]
        found = found - mp.lu_solve(slopes, gap)
    return found


def _gap(wanted, place):
    turn = place[:3, :3].T * wanted[:3, :3]
    move = wanted[:3, 3] - place[:3, 3]
    return mp.matrix([*move, turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])


def shown(value):
    """Decimal strings, row by row."""
    if isinstance(value, mp.matrix):
        if value.cols == 1:
            return [mp.nstr(value[i], SHOWN) for i in range(value.rows)]
        return [[mp.nstr(value[i, j], SHOWN) for j in range(value.cols)] for i in range(value.rows)]
    return mp.nstr(value, SHOWN)


def answers(name, given):
    """Return the answers of a data set to its inputs."""
    with mp.workdps(DIGITS):
        return {key: shown(value) for key, value in _SOLVERS[name](given).items()}


def _plane(given):
    return {
        "three_point_frame": three_point_frame(given["three_points_m"]),
        "six_point_frame": six_point_frame(given["six_points_m"]),
    }


def _registration(given):
    transform, rms = best_fit(given["source_m"], given["target_m"])
    return {"target_source": transform, "rms_m": rms}


def _tool_point(given):
    answer, rms = tool_point(given["touches"])
    return {"tip_in_flange_m": answer[:3], "pin_in_base_m": answer[3:6], "rms_m": rms}


def _dh(given):
    return {f"flange_{i}": flange(given["rows"], joints) for i, joints in enumerate(given["joints_rad"])}


def _compensation(given):
    return {
        f"joints_{i}": compensated(given["nominal"], given["real"], joints)
        for i, joints in enumerate(given["joints_rad"])
    }


_SOLVERS = {
    "plane": _plane,
    "registration": _registration,
    "tool_point": _tool_point,
    "dh": _dh,
    "compensation": _compensation,
}
_UR10 = [  # published nominal table: theta, d, a, alpha, beta
    [0, "0.1273", 0, "1.5707963267948966", 0],
    [0, 0, "-0.612", 0, 0],
    [0, 0, "-0.5723", 0, 0],
    [0, "0.163941", 0, "1.5707963267948966", 0],
    [0, "0.1157", 0, "-1.5707963267948966", 0],
    [0, "0.0922", 0, 0, 0],
]


def _drawn():
    """Inputs with few digits, so that a file holds exactly what a double holds nearly."""
    dice = random.Random(20261121)

    def near(scale, digits=6):
        return round(dice.uniform(-scale, scale), digits)

    def points(count, scale):
        return [[near(scale) for _ in range(3)] for _ in range(count)]

    source = points(8, 1.0)
    turned = (
        turn_z(mp.mpf("0.7")) * turn_y(mp.mpf("-1.1")) * turn_x(mp.mpf("2.3")) * shift(1, -2, mp.mpf("0.5"))
    )
    target = []
    for point in source:
        moved = turned * mp.matrix([*map(mp.mpf, point), 1])
        target.append([round(float(moved[i]) + near(5e-4), 7) for i in range(3)])
    tip, pin = mp.matrix(["0.031", "-0.012", "0.204"]), mp.matrix(["0.8", "0.1", "0.3"])
    touches = []
    for _ in range(6):
        attitude = turn_z(mp.mpf(near(3))) * turn_y(mp.mpf(near(0.8))) * turn_x(mp.mpf(near(0.8)))
        place = pin - attitude[:3, :3] * tip
        for i in range(3):
            attitude[i, 3] = mp.mpf(round(float(place[i]) + near(2e-4), 7))
        touches.append([[mp.nstr(attitude[i, j], 20) for j in range(4)] for i in range(4)])
    real = [
        [near(5e-3), str(mp.mpf(str(row[1])) + near(8e-4)), str(mp.mpf(str(row[2])) + near(8e-4)),
         str(mp.mpf(str(row[3])) + near(1e-3)), near(1e-3)]
        for row in _UR10
    ]  # fmt: skip
    postures = [
        [0.4, -1.2, 1.3, -1.3, 1.2, 0.3],
        [-2.1, -0.7, -1.6, 0.4, -1.4, 2.9],
        [1.1, -2.2, 0.9, 2.5, 0.8, -1.7],
    ]
    wide = [[near(3), near(0.5), near(0.5), near(3), near(0.5)] for _ in range(6)]
    return {
        "plane": {
            "three_points_m": [[0.812, -0.305, 0.11], [1.307, 0.048, 0.133], [0.55, 0.266, 0.092]],
            "six_points_m": [
                [0.9, 0.1, 0.205], [1.2, 0.15, 0.21], [1.0, 0.5, 0.195],
                [0.85, 0.02, 0.16], [1.25, 0.07, 0.17], [0.801, 0.3, 0.18], [1.0, 0.2, 0.6],
            ],
        },
        "registration": {"source_m": source, "target_m": target},
        "tool_point": {"touches": touches},
        "dh": {"rows": wide, "joints_rad": postures},
        "compensation": {"nominal": _UR10, "real": real, "joints_rad": postures},
    }  # fmt: skip


_TITLES = {
    "plane": "Frames on three points and on 3-2-1 points",
    "registration": "Best-fit rigid transform of eight noisy points",
    "tool_point": "Tool tip and pin from six noisy touches",
    "dh": "Flange of a DH chain with beta, at three postures",
    "compensation": "Joints of an arm with errors that reach the nominal arm's flange",
}
_TOLERANCES = {"plane": 1e-13, "registration": 1e-12, "tool_point": 1e-12, "dh": 1e-13, "compensation": 1e-7}


def write():
    """Draw the inputs and write every file."""
    with mp.workdps(DIGITS):
        drawn = _drawn()
    for name, given in drawn.items():
        document = {
            "title": _TITLES[name],
            "solver": f"tests/unit/helpers/reference_solver.py, mpmath, {DIGITS} digits",
            "tolerance": _TOLERANCES[name],
            "given": given,
            "answers": answers(name, given),
        }
        text = json.dumps(document, indent=1) + "\n"
        (FOLDER / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write()
