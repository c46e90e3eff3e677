"""What must be set in a tracker before its numbers mean anything.

Set by us, read back, and read again after every measurement, because other programs may be connected too.
"""

import struct
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.laser_tracker.link import EmsconLink
from cellcal.drivers.laser_tracker.packets import MeasurementMode, TrackerCommand

_UNITS = (0, 0, 0, 0, 0)  # metre, radian, degree Celsius, millibar, per cent
_RIGHT_HANDED = (0,)  # x, y, z, right-handed
_FLAGS = {
    1: 0,
    2: 0,
    4: 1,
    5: 0,
    6: 0,
}  # no transformation, no orientation, unasked messages, no stream, no tries
_EXTENDED, _STANDARD = 1, 0
_NOT_IMPLEMENTED = 2
_OTHERS = "End other programs that use the tracker, then measure this point again."


@dataclass(frozen=True, slots=True)
class _Setting:
    name: str
    read: TrackerCommand
    write: TrackerCommand
    layout: str


_SETTINGS = (
    _Setting("units", TrackerCommand.GET_UNITS, TrackerCommand.SET_UNITS, "<5I"),
    _Setting(
        "coordinate system", TrackerCommand.GET_COORDINATE_SYSTEM, TrackerCommand.SET_COORDINATE_SYSTEM, "<I"
    ),
    _Setting(
        "system settings", TrackerCommand.GET_SYSTEM_SETTINGS, TrackerCommand.SET_SYSTEM_SETTINGS, "<I8i"
    ),
    _Setting(
        "measurement mode", TrackerCommand.GET_MEASUREMENT_MODE, TrackerCommand.SET_MEASUREMENT_MODE, "<I"
    ),
)


class TrackerSettings:
    """Units, axes, flags, mode and reflector of one tracker."""

    def __init__(self, link: EmsconLink, reflector: int | None) -> None:
        self._link, self._reflector = link, reflector

    async def frame_only(self) -> None:
        """Set units and axes: what every other number of the tracker depends on."""
        for setting in _SETTINGS[:2]:
            await self._apply_setting(setting, MeasurementMode.POINT)

    async def apply_settings(self, mode: MeasurementMode) -> None:
        """Set what differs and read it back.

        Raises
        ------
        RefusedError
            The tracker does not take a setting, or another reflector is chosen than the one that was.
        """
        for setting in _SETTINGS:
            await self._apply_setting(setting, mode)
        await self._check_reflector()

    async def ask_covariances(self) -> None:
        """Ask for covariances with every point; a tracker that has none gives standard deviations only."""
        try:
            await self._link.send_command(
                TrackerCommand.SET_STATISTIC_MODE, struct.pack("<II", _EXTENDED, _STANDARD)
            )
        except RefusedError as error:
            if error.vendor_code != _NOT_IMPLEMENTED:
                raise

    async def check_settings(self, mode: MeasurementMode) -> None:
        """Refuse what was measured when a setting is no longer as it was made."""
        for setting in _SETTINGS:
            found = await self._read_setting(setting)
            if found != _expected_values(setting, found, mode):
                raise RefusedError(
                    self._link.device,
                    make_message(
                        "another program changed the tracker's {setting} while it measured; not used.",
                        setting=setting.name,
                    ),
                    remedy=_OTHERS,
                )
        await self._check_reflector()

    async def _apply_setting(self, setting: _Setting, mode: MeasurementMode) -> None:
        found = await self._read_setting(setting)
        expected = _expected_values(setting, found, mode)
        if found == expected:
            return
        await self._link.send_command(setting.write, struct.pack(setting.layout, *expected))
        found = await self._read_setting(setting)
        if found != expected:
            raise RefusedError(
                self._link.device,
                make_message(
                    "the tracker did not take the {setting}: it has {found}, wanted were {expected}.",
                    setting=setting.name,
                    found=found,
                    expected=expected,
                ),
                remedy=_OTHERS,
            )

    async def _read_setting(self, setting: _Setting) -> tuple[int, ...]:
        return tuple(
            int(value) for value in await self._link.send_command(setting.read, layout=setting.layout)
        )

    async def _check_reflector(self) -> None:
        found = int((await self._link.send_command(TrackerCommand.GET_REFLECTOR, layout="<i"))[0])
        if self._reflector is None:
            self._reflector = found
        if found != self._reflector:
            raise RefusedError(
                self._link.device,
                make_message(
                    "reflector {found} is chosen on the tracker, it was {before}: their offsets differ.",
                    found=found,
                    before=self._reflector,
                ),
                remedy=make_message(
                    "Mount and choose reflector {before} again, or begin anew with the other one.",
                    before=self._reflector,
                ),
            )


def _expected_values(setting: _Setting, found: tuple[int, ...], mode: MeasurementMode) -> tuple[int, ...]:
    if setting.read is TrackerCommand.GET_UNITS:
        return _UNITS
    if setting.read is TrackerCommand.GET_COORDINATE_SYSTEM:
        return _RIGHT_HANDED
    if setting.read is TrackerCommand.GET_MEASUREMENT_MODE:
        return (mode,)
    return tuple(_FLAGS.get(i, value) for i, value in enumerate(found))
