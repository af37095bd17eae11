"""The verdict on a weighted fit: whether it misses no more than the noise, and alike at no neighbouring lines."""

import numpy as np

from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify.result import SIGNIFICANCE
from ultraquiet.linalg import portmanteau
from ultraquiet.linalg.sections import search as sections
from ultraquiet.values import Status, StatusWord

TEST_LAGS = 10
# Times the noise, at half of the lines: what a true model misses, of a noise known from two periods, is 1.2 there.
MISSED = 1.5
# Times the noise in the mean, which single lines rule whose noise from two periods looks small by chance: of a thousand
# fits of a thousand lines one reaches it.
MISSED_BY_FAR = 30.0


def whiteness(point: sections.SectionFit, share: float) -> float:
    """Return the p-value that neighbouring lines' residuals are strangers, by a Ljung-Box test of all channels."""
    nf = point.residual.shape[1] // 2
    lags = min(TEST_LAGS, nf // 5)
    if lags < 1:
        return 1.0
    from scipy.special import chdtrc

    statistic, freedom = 0.0, 0
    for r in point.residual:
        for part in (r[:nf], r[nf:]):
            test = portmanteau.ljung_box(part, lags)
            statistic, freedom = statistic + test.statistic, freedom + test.freedom
    # Parameters take their share of the residual's freedom; without it the test would be mild.
    return float(chdtrc(max(freedom * (1.0 - share), 1.0), statistic))


def missed(point: sections.SectionFit) -> float:
    """Return what the fit misses at half of the lines, in deviations of the noise.

    The median of the squares, ln 2 of their mean where noise alone is left: a mean is ruled by the lines whose noise
    chances to look small.
    """
    nf = point.residual.shape[1] // 2
    squares = (point.residual[:, :nf] ** 2 + point.residual[:, nf:] ** 2) / 2
    heard = squares[squares > 0]
    return float(np.sqrt(np.median(heard) / np.log(2))) if heard.size else 0.0


def not_converged(steps: int) -> Status:
    """Return the verdict on a search that ended before a minimum."""
    return Status(StatusWord.NOT_CONVERGED, f"{steps} steps did not reach a minimum; give another order or more steps.")


def verdict(cost: float, p: float, half: float, at_limit: bool) -> Status:
    """Return the verdict on a minimum.

    Args:
        cost: mean square of what is missed, in variances of the noise.
        p: p-value of `whiteness`.
        half: what `missed` tells.
        at_limit: whether higher orders might do better, but were not tried.
    """
    more = "; higher orders were not tried" if at_limit else ""
    if p < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The fit misses {np.sqrt(cost):.3g} times the noise, alike at neighbouring lines ({p_in_words(p)}){more}: "
            f"raise the order, free the delay, or set 'floor' to the relative error you can live with.",
        )
    if half > MISSED or np.sqrt(cost) > MISSED_BY_FAR:
        return Status(
            StatusWord.POOR_FIT,
            f"The fit misses {np.sqrt(cost):.3g} times the noise, {half:.3g} times at half of the lines{more}: raise "
            f"the order, free the delay, give 'period_samples' where the excitation repeats, or set 'floor' to the "
            f"relative error you can live with.",
        )
    return Status(
        StatusWord.OK,
        f"The fit misses {np.sqrt(cost):.3g} times the noise, white over the lines ({p_in_words(p)}){more}.",
    )
