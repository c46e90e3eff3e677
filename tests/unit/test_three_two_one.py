"""The frame of a corner from touched points: exact, its covariance, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import exp_rotation, homogeneous_matrix, inverse_transform, log_transform
from cellcal.calibration.points.frames import PointsDisagreeError
from cellcal.calibration.points.three_two_one import (
    FACES,
    Corner,
    CornerFace,
    CornerFrame,
    FaceName,
    corner_covariance,
    corner_estimate,
    outward_in_frame,
    three_two_one,
)

RADIUS_M = 0.0015
SIGMA_M = 1e-4
LEAST_PLACES: dict[FaceName, tuple[tuple[float, float, float], ...]] = {
    "z": ((0.02, 0.02, 0.0), (0.10, 0.02, 0.0), (0.02, 0.09, 0.0)),
    "y": ((0.02, 0.0, -0.010), (0.10, 0.0, -0.012)),
    "x": ((0.0, 0.05, -0.010),),
}
MORE_PLACES: dict[FaceName, tuple[tuple[float, float, float], ...]] = {
    "z": (*LEAST_PLACES["z"], (0.10, 0.09, 0.0), (0.05, 0.04, 0.0)),
    "y": (*LEAST_PLACES["y"], (0.06, 0.0, -0.040)),
    "x": (*LEAST_PLACES["x"], (0.0, 0.09, -0.012)),
}
TRUE = homogeneous_matrix(exp_rotation(np.array([0.3, -0.2, 0.7])), np.array([0.6, -0.2, 0.1]))
Array = np.ndarray


def touched_faces(
    places: dict[FaceName, tuple[tuple[float, float, float], ...]],
    corner: Corner = "outside",
    errors_m: Array | None = None,
    true: Array = TRUE,
    lean: dict[FaceName, Array] | None = None,
) -> dict[FaceName, CornerFace]:
    """Return where the ball's centre was; ``errors_m`` shift the points along +z, +y, +x. A lean turns a face."""
    found: dict[FaceName, CornerFace] = {}
    first = 0
    for name in FACES:
        axis, normal = "xyz".index(name), outward_in_frame(name, corner)
        turn = np.eye(3) if lean is None or name not in lean else exp_rotation(lean[name])
        points = np.array(places[name]) @ turn.T + RADIUS_M * (turn @ normal)
        if errors_m is not None:
            points[:, axis] += errors_m[first : first + len(points)]
            first += len(points)
        base = points @ true[:3, :3].T + true[:3, 3]
        centres = tuple((float(x), float(y), float(z)) for x, y, z in base)
        x, y, z = true[:3, :3] @ normal
        found[name] = CornerFace(centres, (float(x), float(y), float(z)), (SIGMA_M,) * len(points))
    return found


def fit_corner(faces: dict[FaceName, CornerFace], corner: Corner = "outside") -> CornerFrame:
    return three_two_one(faces, radius_m=RADIUS_M, corner=corner)


def with_sigmas(
    faces: dict[FaceName, CornerFace], sigma_m: dict[FaceName, tuple[float, ...]]
) -> dict[FaceName, CornerFace]:
    return {name: replace(face, sigma_m=sigma_m[name]) for name, face in faces.items()}


def twist_off(found: CornerFrame, true: Array = TRUE) -> Array:
    return log_transform(inverse_transform(true) @ found.base_frame.to_matrix())


@pytest.mark.parametrize("corner", ["outside", "inside"])
@pytest.mark.parametrize("places", [LEAST_PLACES, MORE_PLACES])
@settings(deadline=None)
@given(turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3), shift=st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_perfect_touches_give_the_corner_itself(
    corner: Corner,
    places: dict[FaceName, tuple[tuple[float, float, float], ...]],
    turn: tuple[float, ...],
    shift: tuple[float, ...],
) -> None:
    true = homogeneous_matrix(exp_rotation(np.array(turn)), np.array(shift))
    found = fit_corner(touched_faces(places, corner, true=true), corner)
    assert np.abs(found.base_frame.to_matrix() - true).max() < 1e-11
    assert found.rms_m < 1e-12
    assert found.redundancy == sum(map(len, places.values())) - 6


def test_the_ball_is_taken_off_along_each_normal() -> None:
    faces = touched_faces(LEAST_PLACES)
    too_small = three_two_one(faces, radius_m=RADIUS_M - 0.001, corner="outside")
    assert twist_off(too_small) == pytest.approx([-0.001, -0.001, 0.001, 0.0, 0.0, 0.0], abs=1e-9)
    within = touched_faces(LEAST_PLACES, "inside")
    too_small = three_two_one(within, radius_m=RADIUS_M - 0.001, corner="inside")
    assert twist_off(too_small) == pytest.approx([0.001, 0.001, 0.001, 0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("corner", ["outside", "inside"])
@pytest.mark.parametrize("places", [LEAST_PLACES, MORE_PLACES])
def test_the_estimate_is_what_finite_differences_of_the_solution_give(
    corner: Corner, places: dict[FaceName, tuple[tuple[float, float, float], ...]]
) -> None:
    rng = np.random.default_rng(3)
    sigma = {name: tuple(rng.uniform(5e-5, 3e-4, len(places[name]))) for name in FACES}
    estimate = corner_estimate({name: np.array(places[name]) for name in FACES}, sigma)
    step = 1e-6
    for k in range(estimate.shape[1]):
        error = np.zeros(estimate.shape[1])
        error[k] = step
        ends = [
            twist_off(
                fit_corner(with_sigmas(touched_faces(places, corner, errors_m=sign * error), sigma), corner)
            )
            for sign in (1.0, -1.0)
        ]
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(estimate[:, k], abs=1e-5)


def test_the_covariance_is_that_of_many_corners_felt_with_noise() -> None:
    rng, count = np.random.default_rng(5), sum(map(len, MORE_PLACES.values()))
    errors = rng.normal(scale=SIGMA_M, size=(1500, count))
    kept_count, twists = 0, []
    for error in errors:
        try:
            twists.append(twist_off(fit_corner(touched_faces(MORE_PLACES, errors_m=error))))
            kept_count += 1
        except PointsDisagreeError:
            continue
    assert kept_count > 1480  # one in a thousand is refused
    stated = fit_corner(touched_faces(MORE_PLACES)).covariance_matrix()
    scale = np.sqrt(np.diag(stated))
    found = np.cov(np.array(twists).T)
    assert np.abs(found / np.outer(scale, scale) - stated / np.outer(scale, scale)).max() < 0.12


def test_a_shift_common_to_all_touches_shifts_the_frame_and_turns_nothing() -> None:
    shift = np.array([0.001, -0.002, 0.0005])
    faces = {
        name: replace(face, centres_m=tuple((x + 0.001, y - 0.002, z + 0.0005) for x, y, z in face.centres_m))
        for name, face in touched_faces(LEAST_PLACES).items()
    }
    twist = twist_off(fit_corner(faces))
    assert twist[:3] == pytest.approx(TRUE[:3, :3].T @ shift, abs=1e-9)
    assert np.abs(twist[3:]).max() < 1e-9


def test_farther_points_tell_more() -> None:
    wide = {name: tuple((2 * x, 2 * y, z) for x, y, z in at) for name, at in LEAST_PLACES.items()}
    near, far = (
        corner_covariance(
            {name: np.array(places[name]) for name in FACES},
            {name: (SIGMA_M,) * len(places[name]) for name in FACES},
        )
        for places in (LEAST_PLACES, wide)
    )
    assert (np.diag(far)[3:] < 0.5 * np.diag(near)[3:]).all()


def test_a_point_to_spare_that_contradicts_is_named() -> None:
    error = np.zeros(10)
    error[3] = 0.002
    with pytest.raises(PointsDisagreeError, match="of the z face misses it by") as refused:
        fit_corner(touched_faces(MORE_PLACES, errors_m=error))
    assert "Clean the faces" in refused.value.remedy


@pytest.mark.parametrize(
    ("lean", "message"),
    [({"y": np.array([math.radians(3.0), 0.0, 0.0])}, "87.00"), ({"x": np.array([0.0, 0.0, 0.04])}, "87.7")],
)
def test_faces_that_are_not_square_are_refused_with_their_angle(
    lean: dict[FaceName, Array], message: str
) -> None:
    with pytest.raises(DegenerateDataError, match=f"meet at {message}"):
        fit_corner(touched_faces(MORE_PLACES, lean=lean))


def test_a_small_departure_from_the_right_angle_is_reported() -> None:
    lean: dict[FaceName, Array] = {"y": np.array([1e-4, 0.0, 0.0])}
    found = fit_corner(touched_faces(MORE_PLACES, lean=lean))
    assert abs(found.square_rad[0]) == pytest.approx(1e-4, rel=0.05)
    assert fit_corner(touched_faces(LEAST_PLACES)).square_rad == ()


def _faces_with(name: FaceName, places: tuple[tuple[float, float, float], ...]) -> dict[FaceName, CornerFace]:
    return touched_faces({**LEAST_PLACES, name: places})


@pytest.mark.parametrize(
    ("faces", "words"),
    [
        (_faces_with("z", ((0.02, 0.02, 0.0), (0.06, 0.021, 0.0), (0.1, 0.022, 0.0))), "nearly on one line"),
        (
            _faces_with("z", ((0.02, 0.02, 0.0), (0.021, 0.02, 0.0), (0.02, 0.021, 0.0))),
            "within 20 mm of each other",
        ),
        (_faces_with("z", LEAST_PLACES["z"][:2]), "needs 3 points or more"),
        (_faces_with("y", LEAST_PLACES["y"][:1]), "needs 2 points or more"),
        (_faces_with("y", ((0.02, 0.0, -0.01), (0.02, 0.0, -0.05))), "above each other"),
        (_faces_with("y", ((0.02, 0.0, -0.01), (0.021, 0.0, -0.01))), "within 20 mm of each other"),
    ],
)
def test_bases_that_are_too_short_are_refused(faces: dict[FaceName, CornerFace], words: str) -> None:
    with pytest.raises(DegenerateDataError, match=words):
        fit_corner(faces)


@pytest.mark.parametrize("name", FACES)
def test_a_face_that_looks_another_way_than_it_was_felt_from_is_refused(name: FaceName) -> None:
    faces = touched_faces(LEAST_PLACES)
    x, y, z = TRUE[:3, :3] @ (exp_rotation(np.array([0.6, 0.6, 0.6])) @ outward_in_frame(name, "outside"))
    faces[name] = replace(faces[name], outward=(float(x), float(y), float(z)))
    with pytest.raises(DegenerateDataError, match=f"the {name} face looks .* deg away"):
        fit_corner(faces)


def test_numbers_that_are_none_are_refused() -> None:
    faces = touched_faces(LEAST_PLACES)
    faces["x"] = replace(faces["x"], centres_m=((math.nan, 0.0, 0.0),))
    with pytest.raises(CalibrationError, match="finite"):
        fit_corner(faces)
    faces["x"] = replace(touched_faces(LEAST_PLACES)["x"], sigma_m=(0.0,))
    with pytest.raises(CalibrationError, match="above zero"):
        fit_corner(faces)
