"""Specification of motions and forces against a passive linear environment: n of 2n quantities, section 10.4."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from taut.base.checks import finite_array, finite_scalar, read_only, vector
from taut.base.errors import ShapeError, UsageError, count_of, unknown_name
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array

__all__ = ["Specification", "check_specification", "coefficients_of", "linear_sum", "possible_specifications"]

MIN_SINGULAR_VALUE: Final = 1e-9  # smallest singular value of the specified rows, each scaled to length 1
SPECIFICATION_ROUNDING: Final = 1e-12  # of the largest number: less is zero
MOTIONS: Final = {"M": "V_dot", "B": "V", "K": "X"}
TERM: Final = re.compile(
    r"\s*([+-]?)\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)?\s*\*?\s*([A-Za-z_]\w*)\s*"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Specification(Result):
    """Check of a specification against the environment F = G y + F0, with y the motion that its force depends on.

    Args:
        names: (2n,) of the motions, then of the forces.
        given: (m,) the specified quantities, as text.
        values: (m,) of them; None where names came without.
        reason: Why the specification is not admissible; empty where it is.
        map: (2n, n) from the specified values to all motions and forces, less `offset`; zeros where not admissible.
        offset: (2n,) all motions and forces where the specified values are zero.
    """

    names: tuple[str, ...]
    given: tuple[str, ...]
    values: Float64Array | None
    reason: str
    map: Float64Array
    offset: Float64Array

    @property
    def ok(self) -> bool:
        """The specification is admissible."""
        return not self.reason

    @property
    def determined(self) -> dict[str, str]:
        """The quantities that the environment determines, each as a sum of the specified ones."""
        return {
            name: linear_sum(row, self.given, constant)
            for name, row, constant in zip(self.names, self.map, self.offset, strict=True)
            if self.ok and name not in self.given
        }

    @property
    def quantities(self) -> dict[str, float]:
        """The values of all motions and forces, by name; none where the specification has no values."""
        if self.values is None or not self.ok:
            return {}
        return dict(zip(self.names, (self.map @ self.values + self.offset).tolist(), strict=True))

    def content(self) -> Content:
        """The verdict, and the quantities that the environment determines."""
        title = "specification against a linear environment"
        if not self.ok:
            return Content(title=title, faults=[f"not admissible: {self.reason}"])
        rows = [(name, text, self.quantities.get(name)) for name, text in self.determined.items()]
        return Content(
            title=title,
            summary=[f"{', '.join(self.given)}: admissible"],
            tables=[Table(columns=("determined by the environment", "sum", "value"), rows=rows)],
        )


def check_specification(
    given: Mapping[str, float] | Sequence[str],
    *,
    B: ArrayLike | None = None,
    K: ArrayLike | None = None,
    M: ArrayLike | None = None,
    F0: ArrayLike | None = None,
) -> Specification:
    """Check of motions and forces that are specified together against a passive linear environment.

    Law:          F = G y + F0: n directions have n freedoms among their 2n motions and forces. A specification
                  S (y, F) = s is admissible where S (I; G) has rank n                                   section 10.4

    The environment is one of F = B V + F0, F = K X + F0 and F = M V_dot + F0; forces of lower derivatives, such as
    K X beside B V, are known at that instant and are F0. Quantities are called V1, V2, ..., F1, F2, ... with X or
    V_dot in place of V. F is the force on the environment, F_app.

    Args:
        given: Names and values, or names alone. A name may be a sum, such as "2 V1 + V2".
        B: Damping, a number, (n,) or (n, n), symmetric or not.
        K: Stiffness, likewise.
        M: Inertia, likewise.
        F0: (n,) force that does not depend on the motion at this instant [N, N m]; zero if left out.

    Raises:
        UsageError: None or several of B, K and M; a sum that cannot be read.
        UnknownNameError: A quantity that does not exist.
        ShapeError, RangeError: Matrices of different sizes, numbers that are not finite.

    Example:
        >>> import taut
        >>> check = taut.analysis.check_specification({"V1": 0.1, "F1": 3.0}, B=[[2, 1], [1, 1]])
        >>> check.ok, check.determined
        (True, {'V2': '-2 V1 + F1', 'F2': '-V1 + F1'})
        >>> taut.analysis.check_specification(["F1", "2 V1 + V2"], B=[[2, 1], [1, 1]]).ok
        False

    References:
        Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985), on causality at a port.
    """
    G, names = _environment(B=B, K=K, M=M)
    n = len(G)
    constant = np.append(np.zeros(n), np.zeros(n) if F0 is None else vector("F0", F0, n, unit="N, N m"))
    if isinstance(given, str) or not all(isinstance(text, str) for text in given):
        raise UsageError(f"given must be names, or names with values as {{'V1': 0.1}}; got {given!r}", name="given")
    texts = tuple(" ".join(text.split()) for text in given)
    values = None
    if isinstance(given, Mapping):
        values = np.array([finite_scalar(f"given[{text!r}]", value) for text, value in given.items()])
    rows = np.array([coefficients_of(text, names, "the environment", "quantity") for text in texts]).reshape(
        -1, 2 * n
    )
    of_motion = np.vstack([np.eye(n), G])
    S, reason = rows @ of_motion, ""
    if len(rows) != n:
        reason = f"n = {count_of(n, 'freedom')}, got {len(rows)}"
    elif _dependent(rows, S, G):
        reason = f"{', '.join(texts)} are dependent in this environment"
    map_ = np.zeros((2 * n, len(rows))) if reason else of_motion @ np.linalg.inv(S)
    return Specification(
        names=names, given=texts, values=None if values is None else read_only(values), reason=reason,
        map=read_only(map_), offset=read_only(constant - map_ @ (rows @ constant)),
    )  # fmt: skip


def possible_specifications(
    *, B: ArrayLike | None = None, K: ArrayLike | None = None, M: ArrayLike | None = None
) -> tuple[tuple[str, ...], ...]:
    """Every choice of n of the 2n motions and forces that is admissible against a linear environment.

    Args:
        B: Damping, a number, (n,) or (n, n); one of B, K and M.
        K: Stiffness, likewise.
        M: Inertia, likewise.

    Raises:
        UsageError: None of them, or more than one.

    Example:
        >>> import taut
        >>> len(taut.analysis.possible_specifications(B=[[2, 1], [1, 1]]))
        6
        >>> taut.analysis.possible_specifications(B=[2.0, 0.0])
        (('V1', 'V2'), ('V2', 'F1'))
    """
    G, names = _environment(B=B, K=K, M=M)
    return tuple(c for c in combinations(names, len(G)) if check_specification(c, B=B, K=K, M=M).ok)


def _environment(**matrices: ArrayLike | None) -> tuple[Float64Array, tuple[str, ...]]:
    """G (n, n), and the names of the 2n quantities."""
    given = {name: matrix for name, matrix in matrices.items() if matrix is not None}
    if len(given) != 1:
        raise UsageError(
            f"a linear environment takes one of B, K and M, and F0= for the rest; got {', '.join(given) or 'none'}",
            name="B",
        )
    ((name, value),) = given.items()
    G = finite_array(name, value)
    n = len(G) if G.ndim else 1
    if G.shape not in ((), (n,), (n, n)):
        raise ShapeError(f"{name} must be a number, (n,) or (n, n); got shape {G.shape}", name=name)
    G = G if G.ndim == 2 else np.diag(np.broadcast_to(G, (n,)))
    return G, tuple(f"{symbol}{i + 1}" for symbol in (MOTIONS[name], "F") for i in range(n))


def _dependent(rows: Float64Array, S: Float64Array, G: Float64Array) -> bool:
    """Rows S (n, n) over the motion are dependent, or one is zero but for rounding."""
    n, sizes = len(G), np.linalg.norm(S, axis=1)
    terms = np.abs(rows[:, :n]).sum(axis=1) + np.abs(G).max() * np.abs(rows[:, n:]).sum(axis=1)
    if (sizes <= SPECIFICATION_ROUNDING * terms).any():
        return True
    return float(np.linalg.svd(S / sizes[:, np.newaxis], compute_uv=False)[-1]) <= MIN_SINGULAR_VALUE


# -------------------------------------------------------------------- linear combinations of named quantities


def coefficients_of(text: str, names: Sequence[str], owner: str, kind: str) -> Float64Array:
    """Coefficients of a linear combination of named quantities.

    Args:
        text: A name, or a sum with numbers before names, such as "2 V1 + V2" or "F1 - 0.5*F2".
        names: The quantities.
        owner: What has these quantities, for messages.
        kind: What they are, for messages.

    Raises:
        UsageError: Text that is no such sum.
        UnknownNameError: A name that is not among them.

    Example:
        >>> coefficients_of("2 V1 - F2", ["V1", "V2", "F1", "F2"], "the environment", "quantity").tolist()
        [2.0, 0.0, 0.0, -1.0]
    """
    row, place = np.zeros(len(names)), 0
    while place < len(text) or not text.strip():
        match = TERM.match(text, place)
        if match is None or (place and not match[1]):
            raise UsageError(
                f"a {kind} is a name or a sum such as '2 {names[0]} + {names[-1]}'; got {text!r}",
                name="given",
                value=text,
            )
        sign, number, name = match.groups()
        if name not in names:
            raise unknown_name(owner, kind, name, names)
        row[names.index(name)] += (-1.0 if sign == "-" else 1.0) * (1.0 if number is None else float(number))
        place = match.end()
    return row


def linear_sum(coefficients: Float64Array, names: Sequence[str], constant: float = 0.0) -> str:
    """A linear combination as text.

    Example:
        >>> linear_sum(np.array([2.0, 0.0, -1.0]), ["V1", "V2", "F1"], 0.5)
        '2 V1 - F1 + 0.5'
    """
    smallest = SPECIFICATION_ROUNDING * float(np.abs(coefficients).max(initial=0.0))
    text = ""
    for c, name in [*zip(coefficients, names, strict=True), (constant, "")]:
        if abs(c) <= smallest:
            continue
        size, factor = f"{abs(c):.6g}", f"({name})" if " " in name else name
        sign = f" {'-' if c < 0.0 else '+'} " if text else "-" if c < 0.0 else ""
        text += sign + (factor if size == "1" and name else f"{size} {factor}".rstrip())
    return text or "0"
