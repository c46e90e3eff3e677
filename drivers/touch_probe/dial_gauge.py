"""A dial gauge with a 4-20 mA output on an analogue input."""

from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import GaugeCapabilities, LengthReading
from cellcal.drivers.touch_probe.coupler import Coupler
from cellcal.drivers.touch_probe.coupler_device import CouplerDevice
from cellcal.drivers.wire.deadline import answer_deadline


@dataclass(frozen=True, slots=True)
class DialOptions:
    """The cell file's options of this gauge."""

    range_m: float
    sigma_m: float
    end_margin_m: float
    deadline_s: float


class DialGauge(CouplerDevice):
    """DistanceGauge: how far the plunger is pushed in."""

    def __init__(self, coupler: Coupler, options: DialOptions) -> None:
        super().__init__(coupler, options.deadline_s)
        self._options = options

    @property
    def capabilities(self) -> GaugeCapabilities:
        return GaugeCapabilities(self._options.range_m, self._step_m, self._options.sigma_m)

    async def read_distance(self) -> LengthReading:
        async with answer_deadline(self.name, self._options.deadline_s, "reading the dial gauge"):
            image = await self._coupler.read_fresh_image()
        word = image.words[self._coupler.wiring.analogue_input - 1]
        try:
            count = self._coupler.table.current_loop.decode_steps(word)
        except ValueError as error:
            raise RefusedError(
                self.name,
                make_message("the analogue input reports {error}.", error=error),
                remedy="Check the dial gauge's cable and supply, and that its plunger is not at its end.",
                vendor_code=word,
            ) from error
        value_m = count * self._step_m
        self._require_range(value_m)
        return LengthReading(value_m, self._options.sigma_m, image.answered_s, count)

    @property
    def _step_m(self) -> float:
        return self._options.range_m / self._coupler.table.current_loop.steps

    def _require_range(self, value_m: float) -> None:
        margin_m = self._options.end_margin_m
        if value_m <= margin_m:
            raise RefusedError(
                self.name,
                make_message(
                    "the plunger is free ({value_mm:.3f} mm): it touches nothing.", value_mm=value_m * 1000.0
                ),
                remedy="Bring the gauge against the surface until the plunger is pushed in.",
            )
        if value_m >= self._options.range_m - margin_m:
            raise RefusedError(
                self.name,
                make_message("the plunger is at its end ({value_mm:.3f} mm).", value_mm=value_m * 1000.0),
                remedy="Move the arm back before anything bends, then choose a pose within the gauge's range.",
            )
