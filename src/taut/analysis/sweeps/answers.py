"""Answers from the table of a sweep: success rate, percentile bands over a parameter, what matters most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.plot_style import INK, SMALL, WIDTH, colour, prepared, short_name
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIDENCE_LEVEL: Final = 0.95  # of confidence, of every interval
PERCENTILES: Final = (5.0, 25.0, 50.0, 75.0, 95.0)
GROUPS: Final = 20  # of samples, each of which is left out once for the spread of an estimate
MIN_SAMPLES: Final = 2 * GROUPS  # for a variance share
BINS: Final = (4, 20)  # of a parameter, at least and at most
PANELS: Final = 3  # parameters in a picture of bands
BARS: Final = 8  # parameters in a picture or a table of shares


@dataclass(frozen=True, kw_only=True)
class Rate:
    """A fraction of samples, with the exact interval of Clopper and Pearson for samples drawn independently."""

    count: int
    samples: int

    @property
    def value(self) -> float:
        """The fraction; NaN of no samples."""
        return self.count / self.samples if self.samples else np.nan

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Both ends of the 95 % interval."""
        from scipy.special import betaincinv

        k, rest, tail = self.count, self.samples - self.count, 0.5 * (1.0 - CONFIDENCE_LEVEL)
        low = float(betaincinv(k, rest + 1, tail)) if k else 0.0
        return low, float(betaincinv(k + 1, rest, 1.0 - tail)) if rest else 1.0

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.value:.4g} % (95 % interval {100 * low:.4g} to {100 * high:.4g} %)"


def rate_of(good: NDArray[np.bool_]) -> Rate:
    """The fraction of samples that are good."""
    return Rate(count=int(np.count_nonzero(good)), samples=len(good))


@dataclass(frozen=True, kw_only=True, eq=False)
class Bands:
    """Percentiles of a number in bins of a parameter, with about as many samples in each.

    Args:
        x: (b,) mean of the parameter in each bin.
        percentiles: (5, b) the 5th, 25th, 50th, 75th and 95th; NaN in a bin without a finite number.
        counts: (b,) samples in each bin.
    """

    x: Float64Array
    percentiles: Float64Array
    counts: NDArray[np.int64]


def bins_of(x: Float64Array) -> NDArray[np.int64]:
    """(N,) number of the bin of each sample: one for each value of few, else equally full ones."""
    most = int(np.clip(0.5 * np.sqrt(len(x)), *BINS))
    edges = np.unique(x)
    if len(edges) > most:
        edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, most + 1)[:-1]))
    return np.asarray(np.searchsorted(edges, x, side="right") - 1)


def bands_of(x: Float64Array, y: Float64Array) -> Bands:
    """Percentiles of y over x."""
    bins = bins_of(x)
    parts = [(x[bins == b], y[bins == b]) for b in range(bins.max() + 1)]
    percentiles = np.full((len(PERCENTILES), len(parts)), np.nan)
    for b, (_, values) in enumerate(parts):
        finite = values[np.isfinite(values)]
        percentiles[:, b] = np.percentile(finite, PERCENTILES) if len(finite) else np.nan
    return Bands(
        x=np.array([each.mean() for each, _ in parts]),
        percentiles=percentiles,
        counts=np.array([len(each) for each, _ in parts]),
    )


@dataclass(frozen=True, kw_only=True)
class Share:
    """How much one parameter matters for a number.

    Args:
        path: The parameter.
        share: First-order share of the variance of the number's ranks: what is gone of it, on average, once this
            parameter alone is known. 0 for none, 1 where it alone determines the order of the samples.
        interval: Half of the 95 % interval of that.
        correlation: Rank correlation (Spearman): its sign is the direction, its square what a monotone dependence
            has of the share.
    """

    path: str
    share: float
    interval: float
    correlation: float


def shares_of(inputs: Mapping[str, Float64Array], y: Float64Array) -> tuple[Share, ...]:
    """The share of each parameter in the variance of the ranks of y, the largest first; none where y is constant.

    Law:   eta^2 = Var(E[r(y) | x]) / Var(r(y)), by bins of x, less what chance alone gives B bins of N samples:
           1 - (1 - eta^2) (N - 1) / (N - B)

    It assumes parameters drawn independently of each other: then the shares add to at most 1, and the rest is due to
    joint effects and noise. Dependence within a bin is not seen. The interval is that of a jackknife by groups.

    References:
        Saltelli et al., Global Sensitivity Analysis (2008), section 4.2 (first-order index); Kelley, PNAS 21, 554
        (1935) (the correction); Quenouille, Biometrika 43, 353 (1956), and Efron and Stein, Ann. Stat. 9, 586 (1981).
    """
    from scipy.special import stdtrit
    from scipy.stats import rankdata

    known = np.isfinite(y)
    if np.count_nonzero(known) < MIN_SAMPLES or np.ptp(y[known]) == 0.0:
        return ()
    rank = _standard(rankdata(y[known]))
    group = np.arange(len(rank)) % GROUPS
    width = float(stdtrit(GROUPS - 1, 0.5 + 0.5 * CONFIDENCE_LEVEL))
    out = []
    for path, column in inputs.items():
        x = column[known]
        if np.ptp(x) == 0.0:
            continue
        shares = _shares(bins_of(x), group, rank)
        spread = np.sqrt((GROUPS - 1) / GROUPS * np.sum((shares[1:] - shares[1:].mean()) ** 2))
        out.append(
            Share(
                path=path, share=float(np.clip(shares[0], 0.0, 1.0)), interval=float(width * spread),
                correlation=float(np.mean(_standard(rankdata(x)) * rank)),
            )
        )  # fmt: skip
    return tuple(sorted(out, key=lambda each: -each.share))


def _standard(x: Float64Array) -> Float64Array:
    return np.asarray((x - x.mean()) / x.std())


def _shares(bins: NDArray[np.int64], group: NDArray[np.int64], y: Float64Array) -> Float64Array:
    """(1 + GROUPS,) the corrected share of all samples, and of all but each group."""
    many = int(bins.max()) + 1

    def sums(of: Float64Array | None) -> Float64Array:
        each = np.bincount(group * many + bins, of, minlength=GROUPS * many).reshape(GROUPS, many)
        whole = each.sum(axis=0)
        return np.asarray(np.vstack([whole, whole - each]), dtype=np.float64)

    n, s, ss = sums(None), sums(y), sums(y**2).sum(axis=1)
    N, mean = n.sum(axis=1), s.sum(axis=1) ** 2 / n.sum(axis=1)
    filled = n > 0.0
    between = np.sum(np.divide(s**2, n, out=np.zeros_like(s), where=filled), axis=1) - mean
    return np.asarray(1.0 - (1.0 - between / (ss - mean)) * (N - 1.0) / (N - filled.sum(axis=1)))


# -------------------------------------------------------------------- pictures


def drawn_bands(inputs: Mapping[str, Float64Array], name: str, y: Float64Array, good: NDArray[np.bool_]) -> Figure:
    """Bands of a number over some parameters, and below them the success rate where it is neither 0 nor 1."""
    from matplotlib.figure import Figure

    rows = 2 if 0 < np.count_nonzero(good) < len(good) else 1
    figure = Figure(figsize=(WIDTH, 0.4 + 2.1 * rows), layout="constrained")
    axes = figure.subplots(rows, len(inputs), squeeze=False, sharex="col", sharey="row")
    for column, (path, x) in zip(axes.T, inputs.items(), strict=True):
        bands, mark = bands_of(x, y), "o" if len(np.unique(x)) <= BINS[1] else None
        low, lower, middle, higher, high = bands.percentiles
        ax = prepared(column[0], ylabel=name if column[0] is axes[0, 0] else "")
        for a, b, alpha, label in ((low, high, 0.15, "5 to 95 %"), (lower, higher, 0.3, "25 to 75 %")):
            ax.fill_between(bands.x, a, b, color=colour(0), alpha=alpha, linewidth=0.0, label=label)
        ax.plot(bands.x, middle, color=colour(0), linewidth=1.5, marker=mark, markersize=3.0, label="median")
        if rows > 1:
            bins, ax = bins_of(x), prepared(column[1], ylabel="success [%]" if column[1] is axes[1, 0] else "")
            rates = [rate_of(good[bins == b]) for b in range(len(bands.x))]
            ends = 100.0 * np.array([rate.interval for rate in rates]).T
            ax.fill_between(bands.x, *ends, color=colour(2), alpha=0.25, linewidth=0.0, label="95 % interval")
            values = [100.0 * rate.value for rate in rates]
            ax.plot(bands.x, values, color=colour(2), linewidth=1.5, marker=mark, markersize=3.0)
        column[-1].set_xlabel(short_name(path, 34), fontsize=SMALL, color=INK)
    for row in axes:
        row[0].legend(fontsize=SMALL, frameon=False, labelcolor=INK)
    return figure


def drawn_shares(shares: Mapping[str, Sequence[Share]]) -> Figure:
    """Bars of variance shares, for each number by name, with their intervals and the sign of the correlation."""
    from matplotlib.figure import Figure

    bars = max(map(len, shares.values()))
    figure = Figure(figsize=(WIDTH, 0.8 + 0.22 * bars), layout="constrained")
    for i, (ax, (name, each)) in enumerate(
        zip(figure.subplots(1, len(shares), squeeze=False)[0], shares.items(), strict=True)
    ):
        ax = prepared(ax, f"share in {name}", xlabel="of the variance of ranks")
        labels = [f"{short_name(one.path, 26)} ({'+' if one.correlation >= 0.0 else '-'})" for one in each]
        ax.barh(
            labels,
            [one.share for one in each],
            xerr=[one.interval for one in each],
            color=colour(i),
            ecolor=INK,
            height=0.6,
        )
        ax.set_xlim(0.0, 1.0)
        ax.invert_yaxis()
    return figure
