"""[[probe]] driver = "touch_probe" or "dial_gauge" in cell.toml. The models are the factories."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from cellcal.drivers.interfaces import ProbeCapabilities
from cellcal.drivers.wire.device_connection import connection_to

if TYPE_CHECKING:
    from cellcal.drivers.touch_probe.coupler import Coupler
    from cellcal.drivers.touch_probe.dial_gauge import DialGauge
    from cellcal.drivers.touch_probe.probe import CouplerTouchProbe

_FEWEST_CLOSED = 6  # images; a contact open half of the time looks closed in all of them once in 64
_TELEGRAM_SHARE = 0.3  # of the deadline: a failed telegram leaves time for saying so
_MAC = re.compile(r"([0-9A-Fa-f]{2}[:-]?){5}[0-9A-Fa-f]{2}")


class _CouplerConfig(BaseModel):
    """How to reach a coupler, and what is wired to it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    port: int = Field(default=502, ge=1, le=65535)
    serial: str  # MAC-ID, as printed on the coupler
    deadline_s: float = Field(default=1.0, gt=0, le=60)
    echo_output: int | None = Field(
        default=None, ge=1, le=16
    )  # wired to echo_input: shows that the image is updated
    echo_input: int | None = Field(default=None, ge=1, le=256)
    echo_ms: float = Field(default=100.0, gt=0, le=5000)

    @field_validator("serial")
    @classmethod
    def _is_a_mac(cls, serial: str) -> str:
        if not _MAC.fullmatch(serial):
            raise ValueError("is the coupler's MAC-ID: six pairs of hexadecimal digits, 00:30:DE:…")
        return serial

    @model_validator(mode="after")
    def _echo_has_two_ends(self) -> "_CouplerConfig":
        if (self.echo_output is None) is not (self.echo_input is None):
            raise ValueError("echo_output and echo_input go together: one is wired to the other")
        return self

    def _make_coupler(self, *, digital_input: int = 0, analogue_input: int = 0) -> "Coupler":
        from cellcal.drivers.touch_probe.coupler import Coupler, CouplerWiring  # noqa: PLC0415  a cell file is read without the library
        from cellcal.drivers.touch_probe.registers import load_map  # noqa: PLC0415  as above
        from cellcal.drivers.wire.modbus import ModbusLink  # noqa: PLC0415  as above

        echo = (
            None
            if self.echo_output is None or self.echo_input is None
            else (self.echo_output, self.echo_input)
        )
        wiring = CouplerWiring(self.serial, digital_input, analogue_input, echo, self.echo_ms * 1e-3)
        link = ModbusLink(self.name, self.address, self.port, deadline_s=_TELEGRAM_SHARE * self.deadline_s)
        coupler = Coupler(link, load_map(), wiring)
        link.check_server = coupler.check_device
        return coupler


class TouchProbeConfig(_CouplerConfig):
    """A touch-trigger probe on a digital input."""

    driver: Literal["touch_probe"]
    contact_input: int = Field(ge=1, le=256)
    normally_closed: bool = False  # the contact opens when the tip touches, as in kinematic probes
    tip_radius_mm: float = Field(gt=0, le=50)
    pretravel_mm: float = Field(default=0.0, ge=0, le=5)
    sigma_mm: float = Field(ge=1e-4, le=1)
    overtravel_mm: float = Field(gt=0, le=50)
    delay_ms: float = Field(ge=0, le=1000)
    delay_tolerance_ms: float = Field(ge=0, le=1000)
    poll_ms: float = Field(default=2.0, ge=0, le=100)
    bounce_ms: float = Field(default=5.0, ge=0, le=500)  # longest bounce, from the data sheet
    debounce_ms: float = Field(default=8.0, gt=0, le=500)
    silence_ms: float = Field(default=150.0, gt=0, le=2000)  # while a touch is waited for; then the arm stops

    @model_validator(mode="after")
    def _inputs_differ(self) -> "TouchProbeConfig":
        if self.contact_input == self.echo_input:
            raise ValueError("contact_input and echo_input cannot be one input")
        return self

    @asynccontextmanager
    async def open(self) -> AsyncIterator["CouplerTouchProbe"]:
        """Connect, check the MAC-ID, and hang up at the end."""
        from cellcal.drivers.touch_probe.probe import CouplerTouchProbe, ProbeOptions  # noqa: PLC0415  a cell file is read without the library

        options = ProbeOptions(
            self.deadline_s,
            self.poll_ms * 1e-3,
            self.bounce_ms * 1e-3,
            self.debounce_ms * 1e-3,
            _FEWEST_CLOSED,
            self.silence_ms * 1e-3,
            self.normally_closed,
        )
        probe = CouplerTouchProbe(
            self._make_coupler(digital_input=self.contact_input), self._probe_capabilities(), options
        )
        async with connection_to(probe):
            yield probe

    def _probe_capabilities(self) -> ProbeCapabilities:
        settling_ms = max(self.debounce_ms, _FEWEST_CLOSED * self.poll_ms)
        seeing_ms = self.silence_ms + self.bounce_ms + settling_ms + 4 * self.poll_ms
        reaction_ms = self.delay_ms + self.delay_tolerance_ms + seeing_ms
        return ProbeCapabilities(
            tip_radius_m=self.tip_radius_mm * 1e-3,
            pretravel_m=self.pretravel_mm * 1e-3,
            sigma_m=self.sigma_mm * 1e-3,
            overtravel_m=self.overtravel_mm * 1e-3,
            delay_s=self.delay_ms * 1e-3,
            delay_tolerance_s=self.delay_tolerance_ms * 1e-3,
            reaction_s=reaction_ms * 1e-3,
        )


class DialGaugeConfig(_CouplerConfig):
    """A dial gauge with a 4-20 mA output on an analogue input: 4 mA is its zero, 20 mA its range."""

    driver: Literal["dial_gauge"]
    dial_input: int = Field(ge=1, le=64)
    range_mm: float = Field(gt=0, le=500)
    sigma_mm: float = Field(ge=1e-4, le=10)
    end_margin_mm: float = Field(default=0.05, ge=0, le=10)

    @asynccontextmanager
    async def open(self) -> AsyncIterator["DialGauge"]:
        """Connect, check the MAC-ID, and hang up at the end."""
        from cellcal.drivers.touch_probe.dial_gauge import DialGauge, DialOptions  # noqa: PLC0415  a cell file is read without the library

        options = DialOptions(
            self.range_mm * 1e-3, self.sigma_mm * 1e-3, self.end_margin_mm * 1e-3, self.deadline_s
        )
        gauge = DialGauge(self._make_coupler(analogue_input=self.dial_input), options)
        async with connection_to(gauge):
            yield gauge
