"""Answers to the reference problems with fifty digits and none of the product's code: mpmath and elementary steps.

Beside it, ``reference_problems`` draws the inputs and writes the files.
"""

from fractions import Fraction
from math import ceil, floor, isqrt

import mpmath as mp

DIGITS = 50
SHOWN = 25


def to_matrix(rows):
    return mp.matrix([[mp.mpf(str(v)) for v in row] for row in rows])


def to_column(values):
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


def translation_matrix(x, y, z):
    moved = mp.eye(4)
    moved[0, 3], moved[1, 3], moved[2, 3] = x, y, z
    return moved


def flange_pose(rows, joints):
    """Rows theta, d, a, alpha, beta as numbers or decimal strings; the joint adds to theta."""
    place = mp.eye(4)
    for row, joint in zip(rows, joints, strict=True):
        theta, d, a, alpha, beta = (mp.mpf(str(v)) for v in row)
        place = (
            place * turn_z(theta + mp.mpf(joint)) * translation_matrix(0, 0, d) * translation_matrix(a, 0, 0)
        )
        place = place * turn_x(alpha) * turn_y(beta)
    return place


def cross_product(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit_vector(a):
    return a / mp.norm(a)


def frame_matrix(x, y, z, origin):
    result = mp.eye(4)
    for j, axis in enumerate((x, y, z, origin)):
        for i in range(3):
            result[i, j] = axis[i]
    return result


def three_point_frame(points):
    origin, on_x, on_xy = (to_column(p) for p in points)
    x = unit_vector(on_x - origin)
    # Gram-Schmidt on the second direction: the product's way is two cross products.
    side = on_xy - origin
    y = unit_vector(side - x * (x.T * side)[0])
    return frame_matrix(x, y, cross_product(x, y), origin)


def six_point_frame(points):
    """Cramer's rule on the three planes; the last point lies above."""
    p = [to_column(each) for each in points]
    z = unit_vector(cross_product(p[1] - p[0], p[2] - p[0]))
    if (z.T * (p[6] - p[0]))[0] < 0:
        z = -z
    y = unit_vector(cross_product(z, p[4] - p[3]))
    x = cross_product(y, z)
    normals = mp.matrix([[axis[i] for i in range(3)] for axis in (x, y, z)])
    right = mp.matrix([(x.T * p[5])[0], (y.T * p[3])[0], (z.T * p[0])[0]])
    origin = mp.lu_solve(normals, right)
    return frame_matrix(x, y, z, origin)


def best_fit(source, target):
    """B. K. P. Horn, Closed-form solution of absolute orientation using unit quaternions, JOSA A 4 (1987) 629."""
    n = len(source)
    a, b = [to_column(p) for p in source], [to_column(p) for p in target]
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
    return frame_matrix(*axes, origin), mp.sqrt(squares / (3 * n))


def tool_point(touches):
    """Tip and pin by the normal equations of R t - q = -p."""
    normal, right = mp.zeros(6), mp.zeros(6, 1)
    for touch in touches:
        place = to_matrix(touch)
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
        place = to_matrix(touch)
        tip = place[:3, :3] * answer[:3] + place[:3, 3] - answer[3:6]
        squares += mp.norm(tip) ** 2
    return answer, mp.sqrt(squares / (3 * len(touches)))


def compensate_joints(nominal, real, joints):
    """Newton on place and the off-diagonal differences of the two attitudes, derivatives by differences."""
    target_flange = flange_pose(nominal, joints)
    found = to_column(joints)
    for _ in range(8):
        gap = _pose_gap(target_flange, flange_pose(real, found))
        slopes, step = mp.zeros(6), mp.mpf(10) ** -20
        for k in range(6):
            moved = found.copy()
            moved[k] += step
            change = (_pose_gap(target_flange, flange_pose(real, moved)) - gap) / step
            for i in range(6):
                slopes[i, k] = change[i]
        found = found - mp.lu_solve(slopes, gap)
    return found


def _pose_gap(target, place):
    turn = place[:3, :3].T * target[:3, :3]
    move = target[:3, 3] - place[:3, 3]
    return mp.matrix([*move, turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])


def plane_foot(inputs):
    """Least squares of the distances from a plane: it holds the centre, its normal is the smallest eigenvector."""
    tool = mp.matrix([*map(mp.mpf, inputs["tip_in_flange_m"]), 1])
    base = to_matrix(inputs["base"])
    tips = [(base * flange_pose(inputs["rows"], joints) * tool)[:3] for joints in inputs["joints_rad"]]
    centre = sum(tips[1:], tips[0]) / len(tips)
    scatter = mp.zeros(3)
    for tip in tips:
        scatter += (tip - centre) * (tip - centre).T
    values, vectors = mp.eigsy(scatter)
    normal, above = vectors[:, 0], to_column(inputs["above_m"])
    foot = above - normal * (normal.T * (above - centre))[0]
    return foot, mp.sqrt(values[0] / len(tips))


def moved_frames(inputs):
    """Textbook products with inverses by elimination: the product's are by transposing."""
    base_frame, moved = to_matrix(inputs["base_frame"]), to_matrix(inputs["base_frame_moved"])
    other_base_frame = to_matrix(inputs["other_base_frame"])
    base_fixture, other_base_fixture = (
        to_matrix(inputs["base_fixture"]),
        to_matrix(inputs["other_base_fixture"]),
    )
    offset = mp.inverse(base_frame) * moved
    between = other_base_fixture * mp.inverse(base_fixture)
    return {
        "frame_offset": offset,
        "moved_point": offset * to_matrix(inputs["frame_tcp"]),
        "other_base_base": between,
        "clone_change": mp.inverse(other_base_frame) * between * base_frame,
    }


def place_by_lengths(stations, lengths):
    """The point whose distances from stations differ least, in squares, from the lengths: Newton on the gradient."""
    places = [to_column(station) for station in stations]
    measured = [mp.mpf(str(length)) for length in lengths]

    def squared_gradient(*point):
        here, total = mp.matrix(list(point)), mp.zeros(3, 1)
        for place, length in zip(places, measured, strict=True):
            way = here - place
            distance = mp.norm(way)
            total += way * ((distance - length) / distance)
        return list(total)

    # Differences of the spheres' equations are planes: a start from their normal equations.
    rows = mp.matrix([[2 * (p - places[0])[i] for i in range(3)] for p in places[1:]])
    right = mp.matrix([
        measured[0] ** 2 - length**2 + (p.T * p)[0] - (places[0].T * places[0])[0]
        for p, length in zip(places[1:], measured[1:], strict=True)
    ])  # fmt: skip
    start = mp.lu_solve(rows.T * rows, rows.T * right)
    return mp.findroot(squared_gradient, tuple(start), tol=mp.mpf(10) ** -80)


def lost_turns(inputs):
    """Every vector of whole turns that can be among the two best, tried in fractions: nothing is rounded."""
    rows = [[Fraction(str(v)) for v in row] for row in inputs["metres_per_turn_m"]]
    lengths = [Fraction(str(v)) for v in inputs["lengths_m"]]
    variance = Fraction(str(inputs["sigma_m"])) ** 2
    size = len(rows[0])
    information = [[sum(r[i] * r[j] for r in rows) / variance for j in range(size)] for i in range(size)]
    right = [sum(r[i] * y for r, y in zip(rows, lengths, strict=True)) / variance for i in range(size)]
    real = _solve_exactly(information, right)
    pivots, above = _complete_squares(information)
    nearest = [floor(value + Fraction(1, 2)) for value in real]
    other = [nearest[0] + 1, *nearest[1:]]
    limit = max(_squared_distance(pivots, above, real, z) for z in (nearest, other))
    found = sorted((limit - rest, turns) for rest, turns in _vectors_within(pivots, above, real, limit, []))
    return real, found[0], found[1]


def _solve_exactly(matrix_rows, right):
    """Gauss-Jordan elimination in fractions."""
    work = [[*row, value] for row, value in zip(matrix_rows, right, strict=True)]
    for i in range(len(work)):
        work[i] = [value / work[i][i] for value in work[i]]
        for j in range(len(work)):
            if j != i:
                work[j] = [a - work[j][i] * b for a, b in zip(work[j], work[i], strict=True)]
    return [row[-1] for row in work]


def _complete_squares(information):
    """Write x'Mx as sum of pivot_i (x_i + sum_j>i above_ij x_j)^2."""
    work, pivots, above = [list(row) for row in information], [], []
    for i in range(len(work)):
        pivots.append(work[i][i])
        above.append([work[i][j] / work[i][i] for j in range(len(work))])
        for j in range(i + 1, len(work)):
            for k in range(i + 1, len(work)):
                work[j][k] -= pivots[i] * above[i][j] * above[i][k]
    return pivots, above


def _squared_distance(pivots, above, real, whole):
    off = [z - a for z, a in zip(whole, real, strict=True)]
    return sum(
        pivot * (off[i] + sum(above[i][j] * off[j] for j in range(i + 1, len(off)))) ** 2
        for i, pivot in enumerate(pivots)
    )


def _vectors_within(pivots, above, real, remaining, tail):
    """Yield (distance left over, turns) of every whole vector within the limit, from the last motor to the first."""
    i = len(real) - 1 - len(tail)
    if i < 0:
        yield remaining, tail
        return
    centre = real[i] - sum(above[i][i + 1 + k] * (z - real[i + 1 + k]) for k, z in enumerate(tail))
    reach = Fraction(isqrt(floor(remaining / pivots[i] * 10**20)) + 1, 10**10)
    for z in range(ceil(centre - reach), floor(centre + reach) + 1):
        rest = remaining - pivots[i] * (z - centre) ** 2
        if rest >= 0:
            yield from _vectors_within(pivots, above, real, rest, [z, *tail])


def to_decimal_text(value):
    """Decimal strings, row by row; whole numbers as such."""
    if isinstance(value, list):
        return [to_decimal_text(each) for each in value]
    if isinstance(value, int):
        return value
    if isinstance(value, Fraction):
        return to_decimal_text(mp.mpf(value.numerator) / value.denominator)
    if isinstance(value, mp.matrix):
        if value.cols == 1:
            return [mp.nstr(value[i], SHOWN) for i in range(value.rows)]
        return [[mp.nstr(value[i, j], SHOWN) for j in range(value.cols)] for i in range(value.rows)]
    return mp.nstr(value, SHOWN)


def answer_problem(name, inputs):
    """Return the answers of a data set to its inputs."""
    with mp.workdps(DIGITS):
        return {key: to_decimal_text(value) for key, value in SOLVERS[name](inputs).items()}


def _answer_plane(inputs):
    foot, rms = plane_foot(inputs)
    return {"foot_m": foot, "rms_m": rms}


def _answer_frame(inputs):
    return {
        "three_point_frame": three_point_frame(inputs["three_points_m"]),
        "six_point_frame": six_point_frame(inputs["six_points_m"]),
        **moved_frames(inputs),
    }


def _answer_registration(inputs):
    transform, rms = best_fit(inputs["source_m"], inputs["target_m"])
    return {"target_source": transform, "rms_m": rms}


def _tool_point(inputs):
    answer, rms = tool_point(inputs["touches"])
    return {"tip_in_flange_m": answer[:3], "pin_in_base_m": answer[3:6], "rms_m": rms}


def _answer_dh(inputs):
    return {"flanges": [flange_pose(inputs["rows"], joints) for joints in inputs["joints_rad"]]}


def _answer_compensation(inputs):
    found = [compensate_joints(inputs["nominal"], inputs["real"], joints) for joints in inputs["joints_rad"]]
    return {"joints_rad": found}


def _turn_loss(inputs):
    real, best, second = lost_turns(inputs)
    return {
        "real_turns": real,
        "turns": best[1],
        "next_best_turns": second[1],
        "distance": best[0],
        "next_best_distance": second[0],
    }


def _answer_fixture(inputs):
    points = [place_by_lengths(inputs["stations_m"], lengths) for lengths in inputs["lengths_m"]]
    as_rows = [[point[i] for i in range(3)] for point in points]
    pose, rms = best_fit(inputs["drawing_m"], as_rows)
    return {"points_in_base_m": points, "base_fixture": pose, "rms_m": rms}


SOLVERS = {
    "plane": _answer_plane,
    "frame": _answer_frame,
    "registration": _answer_registration,
    "tool_point": _tool_point,
    "dh": _answer_dh,
    "compensation": _answer_compensation,
    "turn_loss": _turn_loss,
    "fixture": _answer_fixture,
}
