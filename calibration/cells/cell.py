"""A cell as the fit sees it: robots with tools and targets, devices, and the series that were measured.

Frames hang in a tree: the world holds the bases of the robots and the devices; a tool is in its robot's flange, a
target in its tool. The world is the base of the first robot unless another place is given for that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.cells.contact_observations import BarLengths, CellObservations
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import PoseObservations, Rows
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.message import make_message

_SYMMETRIC = 1e-9


@dataclass(frozen=True, eq=False)
class CellRobot:
    """An arm of the cell: its nominal model, where its base is in the world, and what an earlier fit found."""

    name: str
    model: RobotModel
    base: FramePrior | None = None  # None: the world for the first robot, else unknown
    previous: ArmState | None = None  # geometry and joint terms to start from and to expect


@dataclass(frozen=True, eq=False)
class CellTool:
    """A frame on a robot's flange. A place left out is unknown: a frame where its turning shows, else a point."""

    name: str
    robot: str
    place: FramePrior | None = None


@dataclass(frozen=True, eq=False)
class CellTarget:
    """A point of a tool, whose place in the tool's frame is known: one of several reflectors of a plate, say."""

    name: str
    tool: str
    place: FramePrior


@dataclass(frozen=True, slots=True)
class DeviceScalar:
    """A number that belongs to a device, such as the zero of a wire: expected value and standard deviation."""

    value: float
    sigma: float  # 0: fixed; infinite: unknown

    def __post_init__(self) -> None:
        if not np.isfinite(self.value) or np.isnan(self.sigma) or self.sigma < 0:
            raise CalibrationError("a scalar is a finite number with a deviation of zero or more")


@dataclass(frozen=True, eq=False)
class CellDevice:
    """A measuring device, or what is touched: one place for each time it was put up, and its own numbers.

    ``scalars`` may name ``zero_m``, ``scale`` and ``radius_m``. Those left out are zero, one and zero; zero and
    scale of a wire are then free above the level of frames, all others fixed.
    """

    name: str
    places: tuple[FramePrior, ...] = (FramePrior.without_prior(),)
    scalars: Mapping[str, DeviceScalar] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, eq=False)
class CellSeries:
    """Rows of one kind by one device of one target; the mounting of a row counts the places of the device.

    ``covariance`` (N, c, c) of the rows' channels, in the device's axes [m^2, m rad, rad^2], goes before their
    standard deviations, which then only say how large its entries are compared with those of other rows.
    """

    name: str
    device: str
    target: str  # or a tool, for its origin
    observations: CellObservations
    covariance: Array | None = None
    groups: Rows | None = (
        None  # (N,): rows with equal entries, in any series of a robot, are held out together
    )

    def __post_init__(self) -> None:
        _check_observations(self.name, self.observations)
        if self.groups is not None and self.groups.shape != (len(self.observations),):
            raise CalibrationError(
                make_message("series {name!r}: one group for every row, please", name=self.name)
            )
        if self.covariance is not None:
            _check_covariance(self.name, self.observations, self.covariance)


@dataclass(frozen=True, eq=False)
class CalibrationCell:
    """Everything that one fit takes together.

    Raises
    ------
    CalibrationError
        Names that occur twice or belong to nothing, joints of another robot, more mountings than places, or a
        robot or device that nothing ties to the world.
    """

    robots: Sequence[CellRobot]
    tools: Sequence[CellTool]
    devices: Sequence[CellDevice]
    series: Sequence[CellSeries]
    targets: Sequence[CellTarget] = ()

    def __post_init__(self) -> None:
        if not self.robots or not self.series:
            raise CalibrationError("a cell needs a robot and a series of observations")
        _refuse_doubles("robot", [robot.name for robot in self.robots])
        _refuse_doubles("target", self._target_names())
        _refuse_doubles("device", [device.name for device in self.devices])
        _refuse_doubles("series", [series.name for series in self.series])
        for tool in self.tools:
            _require_name("robot", tool.robot, [r.name for r in self.robots], f"tool {tool.name!r}")
        for target in self.targets:
            _require_name(
                "tool",
                target.tool,
                [t.name for t in self.tools],
                make_message("target {target_name!r}", target_name=target.name),
            )
        for series in self.series:
            self._check_series(series)

    def tool_of(self, target: str) -> CellTool:
        """Return the tool that carries a target; a tool carries its own origin."""
        for item in self.targets:
            if item.name == target:
                target = item.tool
        return next(tool for tool in self.tools if tool.name == target)

    def robot_of(self, target: str) -> CellRobot:
        """Return the robot that carries a target."""
        name = self.tool_of(target).robot
        return next(robot for robot in self.robots if robot.name == name)

    def find_device(self, name: str) -> CellDevice:
        """Return the device of this name."""
        return next(device for device in self.devices if device.name == name)

    def _target_names(self) -> list[str]:
        return [*(tool.name for tool in self.tools), *(target.name for target in self.targets)]

    def _check_series(self, series: CellSeries) -> None:
        here = make_message("series {name!r}", name=series.name)
        _require_name("device", series.device, [d.name for d in self.devices], here)
        _require_name("target", series.target, self._target_names(), here)
        axes, joints = self.robot_of(series.target).model.axis_count, series.observations.joints_rad.shape[1]
        if axes != joints:
            raise CalibrationError(
                make_message(
                    "{here}: its robot has {axes} joints, its rows have {joints}",
                    here=here,
                    axes=axes,
                    joints=joints,
                )
            )
        places, last = len(self.find_device(series.device).places), int(series.observations.mounting.max())
        if last >= places:
            raise CalibrationError(
                make_message(
                    "{here}: rows of mounting {mounting}, but {device!r} has {places} places.",
                    here=here,
                    mounting=last + 1,
                    device=series.device,
                    places=places,
                ),
                remedy="Give the device one place for each time it was put up.",
            )
        unknown = set(self.find_device(series.device).scalars) - {"zero_m", "scale", "radius_m"}
        if unknown:
            raise CalibrationError(
                make_message(
                    "device {device!r} has no number {unknown!r}",
                    device=series.device,
                    unknown=sorted(unknown)[0],
                )
            )


def _check_observations(name: str, observations: CellObservations) -> None:
    count = len(observations)
    if not count:
        raise CalibrationError(make_message("series {name!r} has no rows", name=name))
    for what, values in observations.__dict__.items():
        if len(values) != count:
            raise CalibrationError(
                make_message(
                    "series {name!r}: {values_count} entries of {what} for {count} rows",
                    name=name,
                    values_count=len(values),
                    what=what,
                    count=count,
                )
            )
    sigmas = [observations.sigma_m] + (
        [observations.sigma_rad] if isinstance(observations, PoseObservations) else []
    )
    if not all(np.isfinite(sigma).all() and (sigma > 0).all() for sigma in sigmas):
        raise CalibrationError(
            make_message("series {name!r}: standard deviations must be finite and above zero.", name=name),
            remedy="State what the device's certificate says; only ratios matter much, sizes are checked.",
        )
    if int(np.min(observations.mounting)) < 0:
        raise CalibrationError(make_message("series {name!r}: mountings count from zero", name=name))
    if isinstance(observations, BarLengths) and bool((observations.lengths_m <= 0).any()):
        raise CalibrationError(make_message("series {name!r}: the length of a bar is above zero", name=name))


def _check_covariance(name: str, observations: CellObservations, covariance: Array) -> None:
    expected_shape = (len(observations), observations.channels, observations.channels)
    if covariance.shape != expected_shape or not np.isfinite(covariance).all():
        raise CalibrationError(
            make_message(
                "series {name!r}: covariances are {expected_shape} finite numbers, not {shape}",
                name=name,
                expected_shape=expected_shape,
                shape=covariance.shape,
            )
        )
    size = np.sqrt(np.abs(np.diagonal(covariance, axis1=1, axis2=2)))
    scaled = covariance / np.maximum(size[:, :, None] * size[:, None, :], 1e-300)
    symmetric = np.abs(scaled - scaled.swapaxes(1, 2)).max() < _SYMMETRIC
    if not symmetric or np.linalg.eigvalsh(scaled).min() <= _SYMMETRIC:
        raise CalibrationError(
            make_message("series {name!r}: a covariance is not symmetric and positive.", name=name),
            remedy="Give every channel a variance above zero, and correlations below one.",
        )


def _refuse_doubles(what: str, names: list[str]) -> None:
    if not all(names):
        raise CalibrationError(make_message("every {what} needs a name; one has none", what=what))
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise CalibrationError(
            make_message(
                "two {what} entries are called {doubled!r}; each needs a name of its own",
                what=what,
                doubled=doubled,
            )
        )


def _require_name(what: str, name: str, names: list[str], where: str) -> None:
    if name not in names:
        raise CalibrationError(
            make_message("{where}: there is no {what} {name!r}.", where=where, what=what, name=name),
            remedy=make_message("Known are {names_text}.", names_text=", ".join(map(repr, names)) or "none"),
        )
