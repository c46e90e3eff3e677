"""The settings in cell.toml that every robot with joint moves in short steps has."""

from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from cellcal.drivers.wire.stepwise_motion import StepwiseOptions

_TELEGRAM_SHARE = 0.5  # of the deadline: a failed telegram leaves time for a stop and for saying so


class StepwiseRobotConfig(BaseModel):
    """How to reach a controller, and how its arm may move. A driver adds its own settings and ``open``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: str
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    port: int | None
    model: str = Field(min_length=1)  # name of the nominal robot model
    serial: str = Field(min_length=1)
    deadline_s: float = Field(default=2.0, gt=0, le=60)
    speed_limit_rad_s: float = Field(gt=0, le=3.0)
    step_s: float = Field(default=0.5, gt=0, le=5.0)  # so long the arm may go on when the link is lost
    settle_s: float = Field(default=0.5, ge=0, le=60)
    stuck_s: float = Field(default=2.0, gt=0, le=60)
    tolerance_rad: float = Field(default=5e-4, gt=0, le=0.01)

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry."""
        return self.driver

    @property
    def telegram_deadline_s(self) -> float:
        """Time limit of one telegram [s]."""
        return _TELEGRAM_SHARE * self.deadline_s

    def stepwise_options(self, axes: int) -> "StepwiseOptions":
        """Return the options of the motion of a robot with so many axes."""
        from cellcal.drivers.wire.stepwise_motion import StepwiseOptions  # noqa: PLC0415  a cell file is read without it

        return StepwiseOptions(
            axes,
            self.deadline_s,
            self.speed_limit_rad_s,
            self.step_s,
            self.settle_s,
            self.stuck_s,
            self.tolerance_rad,
        )
