"""Elementary functions of a graph, from + - * / sqrt floor and selects: the same bits in lanes, in C and on a GPU.

Each is ordinary code on numbers, traced like a law, and becomes a function of machine code or of C. Errors are at
most 2.5 units in the last place, of sine and cosine for |x| < 1e6. The sign of zero is lost.

References:
    Sun's fdlibm (Ng, 1993) for double precision; Cephes (Moshier) and FreeBSD's msun for single precision.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.codegen.program import Block, Program, trace
from taut.trace import math as tm
from taut.trace.graph import NONE, Op
from taut.trace.scalar import Scalar, active_graph, to_node, to_symbol


@dataclass(frozen=True, kw_only=True)
class Real:
    """A type of numbers of C and LLVM, and the constants of the functions in it."""

    name: str
    dtype: type[np.floating[Any]]
    digits: int  # of the significand, in bits
    bias: int  # of the exponent
    pi_half: Sequence[float]  # its sum, in parts whose products with whole numbers are exact
    sin: Sequence[float]
    cos: Sequence[float]
    exp: Sequence[float]
    exp_ends: tuple[float, float]  # beyond them it is 0, and infinite
    log: Sequence[float]
    ln2: tuple[float, float]
    tanh: Sequence[float]
    tanh_divisor: Sequence[float]
    asin: Sequence[float]
    asin_divisor: Sequence[float]
    atan: Sequence[float]

    def rounded(self, value: float) -> float:
        """A constant in this type; in single precision the nearest that is neither infinite nor zero."""
        if self.dtype is np.float64 or value == 0.0 or not math.isfinite(value):
            return value
        limits = np.finfo(np.float32)
        return float(np.float32(math.copysign(min(max(abs(value), float(limits.tiny)), float(limits.max)), value)))

    @property
    def farthest(self) -> float:
        """The largest angle that has a sine: beyond it a number has lost the angle."""
        return 2.0 ** (self.digits - 3)

    @property
    def least(self) -> float:
        """The smallest normal number."""
        return 2.0 ** (1 - self.bias)


DOUBLE: Final = Real(
    name="double",
    dtype=np.float64,
    digits=53,
    bias=1023,
    pi_half=(1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    sin=(
        -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
        2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
    ),
    cos=(
        4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
        -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
    ),
    exp=(
        1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05,
        -1.65339022054652515390e-06, 4.13813679705723846039e-08,
    ),
    exp_ends=(-746.0, 710.0),
    log=(
        6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
        1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01,
    ),
    ln2=(6.93147180369123816490e-01, 1.90821492927058770002e-10),
    tanh=(-1.61468768441708447952e3, -9.92877231001918586564e1, -9.64399179425052238628e-1),
    tanh_divisor=(4.84406305325125486048e3, 2.23548839060100448583e3, 1.12811678491632931402e2, 1.0),
    asin=(
        1.66666666666666657415e-01, -3.25565818622400915405e-01, 2.01212532134862925881e-01,
        -4.00555345006794114027e-02, 7.91534994289814532176e-04, 3.47933107596021167570e-05,
    ),
    asin_divisor=(
        1.0, -2.40339491173441421878e00, 2.02094576023350569471e00, -6.88283971605453293030e-01,
        7.70381505559019352791e-02,
    ),
    atan=(
        3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
        -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
        6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
        -3.65315727442169155270e-02, 1.62858201153657823623e-02,
    ),
)  # fmt: skip
SINGLE: Final = Real(
    name="float",
    dtype=np.float32,
    digits=24,
    bias=127,
    pi_half=(1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
    sin=(-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4),
    cos=(4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5),
    exp=(1.6666625440e-1, -2.7667332906e-3),
    exp_ends=(-104.0, 89.0),
    log=(0.66666662693, 0.40000972152, 0.28498786688, 0.24279078841),
    ln2=(6.9313812256e-01, 9.0580006145e-06),
    tanh=(-3.33332819422e-1, 1.33314422036e-1, -5.37397155531e-2, 2.06390887954e-2, -5.70498872745e-3),
    tanh_divisor=(1.0,),
    asin=(1.6666586697e-01, -4.2743422091e-02, -8.6563630030e-03),
    asin_divisor=(1.0, -7.0662963390e-01),
    atan=(3.3333328366e-01, -1.9999158382e-01, 1.4253635705e-01, -1.0648017377e-01, 6.1687607318e-02),
)


def _operation(op: Op, *operands: Any) -> Any:
    """An operation that law code does not have."""
    graph = active_graph()
    assert graph is not None
    return to_symbol(graph, graph.node(int(op), *(to_node(graph, x) for x in operands)))


def _nan() -> Any:
    graph = active_graph()
    assert graph is not None
    return Scalar(graph, graph._append(int(Op.CONST), NONE, NONE, NONE, math.nan))


def _polynomial(x: Any, coefficients: Sequence[float]) -> Any:
    """By Horner's rule; the constant is the first coefficient."""
    value: Any = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = coefficient + x * value
    return value


def _sine_cosine(x: Any, real: Real) -> Any:
    """Cody and Waite reduction by pi/2 in three parts, then a polynomial; NaN where the angle is lost."""
    k = tm.floor(x * (2.0 / math.pi) + 0.5)
    r = x
    for part in real.pi_half:
        r = r - k * part
    return of_quadrant(k, tm.where(abs(x) < real.farthest, r, _nan()), real)


def of_quadrant(k: Any, r: Any, real: Real) -> Any:
    """Sine and cosine of k pi/2 + r, |r| <= pi/4: odd quadrants swap them, then signs follow."""
    z = r * r
    sine = r + r * z * _polynomial(z, real.sin)
    cosine = (1.0 - 0.5 * z) + z * z * _polynomial(z, real.cos)
    half = 0.5 * k
    whole = tm.floor(half)
    odd = half != whole
    lower = 0.5 * whole != tm.floor(0.5 * whole)
    s, c = tm.where(odd, cosine, sine), tm.where(odd, sine, cosine)
    return tm.where(lower, -s, s), tm.where(odd ^ lower, -c, c)


def _exp(x: Any, real: Real) -> Any:
    """2^k times a rational approximation on |r| <= ln(2) / 2."""
    low, high = real.exp_ends
    x = tm.where(x < low, low, x)
    x = tm.where(x > high, high, x)  # NaN goes through
    k = tm.floor(x * (1.0 / math.log(2.0)) + 0.5)
    above, below = x - k * real.ln2[0], k * real.ln2[1]
    r = above - below
    z = r * r
    c = r - z * _polynomial(z, real.exp)
    return _operation(Op.SCALE, 1.0 - ((below - r * c / (2.0 - c)) - above), k)


def logarithm(x: Any, real: Real) -> Any:
    """k ln(2) + log(1 + f) with 1 + f from sqrt(1/2) to sqrt(2)."""
    lift = real.digits + 1.0
    small = x < real.least
    normal = tm.where(small, x * 2.0**lift, x)
    k = _operation(Op.EXPONENT, normal)
    m = _operation(Op.SCALE, normal, -k)
    large = m > math.sqrt(2.0)
    f = tm.where(large, 0.5 * m, m) - 1.0
    k = tm.where(large, k + 1.0, k) - tm.where(small, lift, 0.0)
    s = f / (2.0 + f)
    square = 0.5 * f * f
    rest = s * (square + s * s * _polynomial(s * s, real.log)) + k * real.ln2[1]
    value = k * real.ln2[0] - ((square - rest) - f)
    return tm.where(x > 0.0, tm.where(x < math.inf, value, x), tm.where(x == 0.0, -math.inf, _nan()))


def _tanh(x: Any, real: Real) -> Any:
    z, a = x * x, abs(x)
    near = x + x * z * (_polynomial(z, real.tanh) / _polynomial(z, real.tanh_divisor))
    far = 1.0 - 2.0 / (tm.exp(2.0 * a) + 1.0)
    return tm.where(a < 0.625, near, tm.where(x < 0.0, -far, far))


def _half_angle(x: Any, real: Real) -> tuple[Any, Any, Any]:
    """Whether |x| <= 1/2; s, and asin(s) - s: for s = |x|, or else for s = sqrt((1 - |x|) / 2), half of acos |x|."""
    a = abs(x)
    near = a <= 0.5
    z = tm.where(near, a * a, 0.5 * (1.0 - a))
    root = tm.sqrt(z)
    s = tm.where(near, a, root)
    correction = tm.where(near, 0.0, (z - root * root) / (root + root + real.least))  # what the root has lost
    return near, s, s * (z * _polynomial(z, real.asin) / _polynomial(z, real.asin_divisor)) + correction


def _asin(x: Any, real: Real) -> Any:
    near, s, rest = _half_angle(x, real)
    value = tm.where(near, s + rest, _less(math.pi / 2.0, 2.0 * (s + rest), real))
    return tm.where(x < 0.0, -value, value)


def _acos(x: Any, real: Real) -> Any:
    near, s, rest = _half_angle(x, real)
    inner = _less(math.pi / 2.0, tm.where(x < 0.0, -(s + rest), s + rest), real)
    outer = 2.0 * (s + rest)
    return tm.where(near, inner, tm.where(x < 0.0, _less(math.pi, outer, real), outer))


def _less(angle: float, x: Any, real: Real) -> Any:
    """pi or a part of it less x, with what the constant lacks, the same in double precision and in extended."""
    low = real.rounded(angle)
    lacks = angle - low if real is SINGLE else angle / math.pi * 1.2246467991473531772e-16
    return low - (x - lacks)


def _atan2(y: Any, x: Any, real: Real) -> Any:
    """Of the smaller over the larger; from tan(pi/8) on of the difference from pi/4. NaN where both are infinite."""
    ay, ax = abs(y), abs(x)
    a, b = tm.minimum(ax, ay), tm.maximum(ax, ay)
    far = tm.where(b > 0.25 / real.least, 0.25, 1.0)  # so that their sum does not overflow
    a, b = a * far, b * far
    upper = a > math.tan(math.pi / 8.0) * b
    t = tm.where(upper, a - b, a) / tm.where(upper, a + b, tm.where(b == 0.0, 1.0, b))
    z = t * t
    rest = t * (z * _polynomial(z, real.atan))
    value = tm.where(upper, _less(math.pi / 4.0, rest - t, real), t - rest)
    value = tm.where(ay > ax, _less(math.pi / 2.0, value, real), value)
    value = tm.where(x < 0.0, _less(math.pi, value, real), value)
    return tm.where(y < 0.0, -value, value)


FUNCTIONS: Final[dict[str, tuple[int, Callable[..., Any]]]] = {  # by name: number of arguments, code
    "sine_cosine": (1, _sine_cosine),
    "exponential": (1, _exp),
    "logarithm": (1, logarithm),
    "hyperbolic_tangent": (1, _tanh),
    "arc_sine": (1, _asin),
    "arc_cosine": (1, _acos),
    "arc_tangent": (2, _atan2),
}
NAMES: Final = {
    Op.SIN: "sine_cosine",
    Op.COS: "sine_cosine",
    Op.EXP: "exponential",
    Op.LOG: "logarithm",
    Op.TANH: "hyperbolic_tangent",
    Op.ASIN: "arc_sine",
    Op.ACOS: "arc_cosine",
    Op.ATAN2: "arc_tangent",
}


@functools.cache
def function(name: str, real: Real) -> Program:
    """A function of these as a program, from its arguments x0, x1 to what it gives."""
    count, code = FUNCTIONS[name]
    return traced(code, count, real)


def traced(code: Callable[..., Any], count: int, real: Real) -> Program:
    """Code on so many numbers, and on the type of them, as a program."""

    def of_blocks(inputs: Any, _parameters: Any, _memory: Any) -> Any:
        values = code(*(inputs[f"x{i}"] for i in range(count)), real)
        return {f"y{i}": y for i, y in enumerate(values if isinstance(values, tuple) else (values,))}, {}

    return trace(of_blocks, Block.of({f"x{i}": () for i in range(count)}), Block(), Block())


def needed(real: Real, *programs: Program) -> list[str]:
    """The functions that programs call, each behind those that it calls itself."""
    found: list[str] = []
    for program in programs:
        ops = program.graph.ops
        for name in dict.fromkeys(NAMES[Op(ops[i])] for i in program.live if ops[i] in NAMES):
            if name not in found:
                found += [each for each in (*needed(real, function(name, real)), name) if each not in found]
    return found
