"""Errors at poses that took no part in a fit, against what the fit predicted of them."""

from cellcal.calibration.uncertainty import chi_square_limit


class PredictedErrors:
    """Whether errors are as predicted; the fields are those of the dataclass that derives from this."""

    __slots__ = ()
    chi_square: float
    degrees_of_freedom: int

    @property
    def most_chi_square(self) -> float:
        """The 99.9 % limit of chi square by the stated uncertainty."""
        return chi_square_limit(self.degrees_of_freedom)

    @property
    def is_as_predicted(self) -> bool:
        """Whether the errors are no larger than the stated uncertainty allows."""
        return self.chi_square <= self.most_chi_square
