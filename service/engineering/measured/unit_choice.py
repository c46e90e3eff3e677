"""Units of a file: those that names or the user state, and guesses for the rest, which the fit checks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.units import ANGLE_UNITS, LENGTH_UNITS, USUAL_LENGTH_UNITS

_MOST_RADIANS = 8.2  # a turn and a third: beyond, angles are degrees
_BY_SIZE = ("m", "mm", "cm", "inch")

FitUnit = Callable[[Mapping[str, float]], str]


@dataclass(frozen=True, slots=True)
class UnitChoice:
    """The stated and the guessed units, and the guesses in words."""

    stated: Mapping[str, str]
    guesses: list[str]
    used: dict[str, str] = field(default_factory=dict)

    def angle_factor(self, meaning: str, columns: Sequence[str], values: Array) -> float:
        """Return rad per unit: degrees if any angle is beyond a turn and a third."""
        if meaning in self.stated:
            return self._stated_factor(meaning, ANGLE_UNITS)
        name = "deg" if float(np.abs(values).max()) > _MOST_RADIANS else "rad"
        self._note_guess(meaning, columns, name)
        return ANGLE_UNITS[name]

    def angle_factors(self, columns: Sequence[str], values: Array) -> Array:
        """Return rad per unit of each column of joints (n,): one unit of all, or one of each with commas between."""
        stated = self.stated.get("joints", "")
        if "," not in stated:
            return np.full(len(columns), self.angle_factor("joints", columns, values))
        each = [unit.strip() for unit in stated.split(",")]
        if len(each) != len(columns):
            raise MeasurementError(
                make_message(
                    "{count} units were stated for {columns}.", count=len(each), columns=", ".join(columns)
                ),
                remedy="Write one unit, or one for each joint that turns: `--units joints=deg,deg,deg,rad,rad,rad`.",
            )
        for unit in each:
            self._check_unit("joints", unit, ANGLE_UNITS)
        self.used["joints"] = ",".join(each)
        return np.array([ANGLE_UNITS[unit] for unit in each])

    def slide(self, meaning: str, columns: Sequence[str], guess: str) -> float:
        """Return m per unit of joints that slide, as stated or as guessed from their travel."""
        if meaning in self.stated:
            return self._stated_factor(meaning, LENGTH_UNITS)
        self._note_guess(meaning, columns, guess)
        return LENGTH_UNITS[guess]

    def length_factor(
        self,
        meaning: str,
        columns: Sequence[str],
        values: Array,
        spread_m: float,
        by_fit: FitUnit | None = None,
    ) -> float:
        """Return m per unit: the one that fits the arm, else in which the values spread as wide as it moved."""
        if meaning in self.stated:
            return self._stated_factor(meaning, LENGTH_UNITS)
        name = by_fit(USUAL_LENGTH_UNITS) if by_fit is not None else ""
        if not name and spread_m > 0:
            spread = float(np.sqrt(((values - values.mean(axis=0)) ** 2).sum(axis=1).mean()))
            misfits = {n: abs(np.log(max(spread * LENGTH_UNITS[n], 1e-12) / spread_m)) for n in _BY_SIZE}
            name = min(misfits, key=lambda n: misfits[n])
        elif not name:
            name = "mm" if float(np.median(np.abs(values))) > 20.0 else "m"
        self._note_guess(meaning, columns, name)
        return LENGTH_UNITS[name]

    def _stated_factor(self, meaning: str, table: Mapping[str, float]) -> float:
        unit = self.stated[meaning]
        self._check_unit(meaning, unit, table)
        self.used[meaning] = unit
        return table[unit]

    @staticmethod
    def _check_unit(meaning: str, unit: str, table: Mapping[str, float]) -> None:
        if unit not in table:
            raise MeasurementError(
                make_message("{meaning} cannot be in {unit!r}.", meaning=meaning, unit=unit),
                remedy=f"`--units {meaning}=UNIT` takes {', '.join(table)}.",
            )

    def _note_guess(self, meaning: str, columns: Sequence[str], unit: str) -> None:
        self.used[meaning] = unit
        self.guesses.append(
            make_message(
                "{meaning} ({columns}) taken as {unit}",
                meaning=meaning,
                columns=", ".join(columns),
                unit=unit,
            )
        )
