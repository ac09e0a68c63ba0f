"""The response of a e'' + b e' + c e = 0 to 50 digits, by power series in fractions of decimals: an oracle."""

from __future__ import annotations

from decimal import Decimal, localcontext

DIGITS = 60


def exact_response(a2: float, a1: float, a0: float, e0: float, v0: float, t: float) -> tuple[float, float]:
    """exp(-sigma t) times whole functions of sigma^2 - omega_n^2, summed term by term: no case of damping is told."""
    with localcontext() as context:
        context.prec = DIGITS
        sigma = Decimal(a1) / (2 * Decimal(a2))
        square = Decimal(a0) / Decimal(a2)
        time, start, rate = Decimal(t), Decimal(e0), Decimal(v0)
        x = (sigma * sigma - square) * time * time
        cosine = sine = Decimal(0)
        even, k = Decimal(1), 0
        while k < 4 or abs(even) > Decimal(10) ** (-DIGITS):
            cosine += even
            sine += even / (2 * k + 1)
            k += 1
            even *= x / ((2 * k - 1) * (2 * k))
        envelope = (-sigma * time).exp()
        e = envelope * (start * cosine + (rate + sigma * start) * time * sine)
        v = envelope * (rate * cosine - (square * start + sigma * rate) * time * sine)
        return float(e), float(v)
