"""What windows of a series gain, from sums up to their edges, against sums over the rows of each window."""

import numpy as np

from cellcal.calibration.identification.series_breaks import (
    _RIDGE,
    _gain_of,
    _inverse_normal,
    _tail_sums,
    _window_gains,
)

PARAMETERS, PLACE, CHANNELS, ROWS = 20, 6, 3, 150


def test_windows_gain_what_their_own_rows_say():
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((PARAMETERS, CHANNELS, ROWS)) * rng.uniform(0.1, 30.0, (PARAMETERS, 1, 1))
    residuals = rng.standard_normal((CHANNELS, ROWS))
    residuals[:, 40:80] += 0.5 * columns[0, :, 40:80]
    place, inverse = columns[:PLACE], _inverse_normal(columns)
    cross = np.zeros((ROWS + 1, PARAMETERS, PLACE))
    gradient = np.zeros((ROWS + 1, PLACE))
    cross[:-1] = _tail_sums(np.einsum("pmn,dmn->npd", columns, place))
    gradient[:-1] = _tail_sums(np.einsum("dmn,mn->nd", place, residuals))
    edges = np.arange(12, ROWS - 12, 7)

    sums = cross, cross[:, :PLACE], gradient, inverse
    begins, ends, gains = _window_gains(sums, residuals, edges, edges)

    assert (ends - begins).min() >= 12
    assert len(gains) == sum(int(end - begin >= 12) for begin in edges for end in edges)
    for begin, end, gain in zip(begins, ends, gains, strict=True):
        inside = columns[:, :, begin:end].reshape(PARAMETERS, -1)
        own = inside[:PLACE] @ inside[:PLACE].T
        schur = own - (shared := inside @ inside[:PLACE].T).T @ inverse @ shared
        schur = schur + _RIDGE * np.trace(schur) * np.eye(PLACE)
        pull = inside[:PLACE] @ residuals[:, begin:end].reshape(-1)
        direct = _gain_of(np.array([pull @ np.linalg.solve(schur, pull)]), residuals, 2 * PLACE + 1)[0]
        assert abs(gain - direct) < 1e-7 * max(abs(direct), 1.0)
