"""Which arm a controller has, judged from what it says: every type code, those that two arms share among them."""

import pytest

from cellcal.drivers.errors import RefusedError, WrongDeviceError
from cellcal.drivers.universal_robots.arm_types import (
    ControllerKind,
    ReportedArm,
    arm_types,
    check_arm,
    controller_kind,
    possible_arms,
)
from cellcal.drivers.universal_robots.state import ControllerVersion

CB3, EARLY, LATE, X = (3, 15), (5, 11), (5, 25), (10, 12)


def reported(version: tuple[int, int], code: int, name: str | None) -> ReportedArm:
    return ReportedArm(ControllerVersion(*version, 0, 0), code, name)


@pytest.mark.parametrize(
    ("version", "code", "name", "models"),
    [
        (CB3, 1, "UR5", "ur5"),
        (CB3, 2, "UR10", "ur10"),
        (CB3, 3, "UR3", "ur3"),
        (CB3, 4, "UR16", ""),
        (EARLY, 1, "UR5", "ur5e"),
        (EARLY, 2, "UR10", "ur10e"),
        (EARLY, 3, "UR3", "ur3e"),
        (EARLY, 4, "UR16", "ur16e"),
        (EARLY, 7, "UR20", ""),  # 5.14 is its first
        ((5, 14), 7, "UR20", "ur20"),
        ((5, 15), 8, "UR30", "ur30"),
        (LATE, 1, "UR5", "ur5e ur7e"),  # the hole: nothing tells them apart
        (LATE, 1, "UR7", "ur7e"),
        (LATE, 1, "UR7e", "ur7e"),
        (LATE, 2, "UR10", "ur10e ur12e"),
        (LATE, 2, "UR12", "ur12e"),
        (LATE, 5, "UR18", "ur18"),
        (LATE, 6, "UR8 Long", "ur8long"),
        (LATE, 6, "UR8_LONG", "ur8long"),
        (LATE, 9, "UR15", "ur15"),
        (X, 1, None, "ur5e ur7e"),
        (X, 2, None, "ur10e ur12e"),
        (X, 3, None, "ur3e"),
        (X, 4, None, "ur16e"),
        (X, 5, None, "ur18"),
        (X, 6, None, "ur8long"),
        (X, 7, None, "ur20"),
        (X, 8, None, "ur30"),
        (X, 9, None, "ur15"),
        (LATE, 1, "UR10", ""),  # code and name contradict each other
        (LATE, 10, "UR40", ""),
        (X, -1, None, ""),
        ((4, 0), 1, "UR5", ""),
        ((11, 0), 1, None, ""),
    ],
)
def test_the_arms_that_fit_a_report(
    version: tuple[int, int], code: int, name: str | None, models: str
) -> None:
    assert possible_arms(reported(version, code, name)) == tuple(models.split())


@pytest.mark.parametrize(
    ("expected", "version", "code", "name", "others"),
    [
        ("ur5e", EARLY, 1, "UR5", ()),
        ("ur5e", LATE, 1, "UR5", ("ur7e",)),
        ("ur7e", LATE, 1, "UR5", ("ur5e",)),
        ("ur7e", LATE, 1, "UR7", ()),
        ("ur12e", X, 2, None, ("ur10e",)),
        ("ur15", X, 9, None, ()),
    ],
)
def test_what_cannot_be_distinguished_is_named(
    expected: str, version: tuple[int, int], code: int, name: str | None, others: tuple[str, ...]
) -> None:
    assert check_arm("arm", "10.0.0.7", expected, reported(version, code, name)) == others


@pytest.mark.parametrize(
    ("expected", "version", "code", "name", "says"),
    [
        ("ur7e", EARLY, 1, "UR5", "answers a ur5e"),  # no UR7e runs that software
        ("ur5e", LATE, 1, "UR7", "answers a ur7e"),
        ("ur10e", LATE, 2, "UR12", "answers a ur12e"),
        ("ur12e", LATE, 1, "UR5", "answers a ur5e / ur7e"),
        ("ur5", EARLY, 1, "UR5", "answers a ur5e"),
        ("ur5e", CB3, 1, "UR5", "answers a ur5 "),
        ("ur18", X, 9, None, "answers a ur15"),
        ("ur5e", LATE, 2, "UR5", "fit no arm"),
        ("ur5e", LATE, 77, "UR99", "fit no arm"),
    ],
)
def test_another_arm_is_refused(
    expected: str, version: tuple[int, int], code: int, name: str | None, says: str
) -> None:
    with pytest.raises(WrongDeviceError) as refused:
        check_arm("arm", "10.0.0.7", expected, reported(version, code, name))
    text = str(refused.value)
    assert text.startswith("arm: ")
    assert says in text
    assert expected in text
    assert "label" in refused.value.remedy


@pytest.mark.parametrize("model", sorted(arm_types()))
def test_every_arm_can_be_what_its_controller_reports(model: str) -> None:
    arm = arm_types()[model]
    assert arm.since
    for kind, first in arm.since:
        name = None if kind is ControllerKind.POLYSCOPE_X else arm.dashboard_names[0]
        assert model in possible_arms(reported(first, arm.code, name))
        before = (first[0], first[1] - 1)
        assert model not in possible_arms(reported(before, arm.code, name)) or first[1] == 0


@pytest.mark.parametrize(
    ("version", "kind"),
    [
        ((3, 12), ControllerKind.CB3),
        ((5, 6), ControllerKind.POLYSCOPE_5),
        ((10, 11), ControllerKind.POLYSCOPE_X),
        ((10, 12), ControllerKind.POLYSCOPE_X),
    ],
)
def test_the_generations(version: tuple[int, int], kind: ControllerKind) -> None:
    assert controller_kind("arm", ControllerVersion(*version, 0, 0)) is kind


@pytest.mark.parametrize("version", [(1, 8), (3, 11), (4, 0), (5, 5), (6, 0), (10, 10), (11, 0)])
def test_software_that_is_not_known_is_refused(version: tuple[int, int]) -> None:
    with pytest.raises(RefusedError, match="does not know") as refused:
        controller_kind("arm", ControllerVersion(*version, 0, 0))
    assert "10.11" in refused.value.remedy
