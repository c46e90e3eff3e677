"""What the pictures of residuals need to know, of one device's identification or of one series of a cell."""

from collections.abc import Sequence
from typing import Protocol

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows


class PlottedResiduals(Protocol):
    """Rows with their errors: N fitted ones, H that were held out."""

    @property
    def figure_title(self) -> str: ...
    @property
    def model_level(self) -> int: ...
    @property
    def joints_rad(self) -> Array: ...  # (N, n)
    @property
    def joint_units(
        self,
    ) -> tuple[Array, tuple[str, ...]]: ...  # factors (n,) to what is shown, and its units
    @property
    def channel_names(self) -> tuple[str, ...]: ...
    @property
    def fit_residuals(self) -> Array: ...  # (channels, N) [m, rad]
    @property
    def signed_mm(self) -> dict[str, tuple[Array, Array]]: ...  # by direction: before and after (N,)
    @property
    def fitted_rows(self) -> Rows: ...  # of the file (N,)
    @property
    def rejected_positions(self) -> Rows: ...  # among the fitted
    @property
    def rejected_rows(self) -> Sequence[int]: ...  # of the file
    @property
    def held_out_rows(self) -> Rows: ...  # of the file (H,)
    @property
    def held_out_m(self) -> Array: ...  # (H,)
    @property
    def before_m(self) -> Array: ...  # (H,)
    @property
    def mounting_breaks(self) -> tuple[int, ...]: ...
