"""Specification of motions and forces against a passive linear environment: n of 2n quantities, section 10.4."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from taut.base.checks import finite_array, finite_scalar, read_only, vector
from taut.base.errors import RangeError, ShapeError, UsageError, count_of, unknown_name
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array

__all__ = ["Specification", "check_specification", "coefficients_of", "linear_sum", "possible_specifications"]

DEPENDENT: Final = 1e-9  # smallest singular value of the specified rows, each scaled to length 1
NEARLY_DEPENDENT: Final = 1e-3
NO_FORCE: Final = 1e-12  # of the environment's largest number: a force that no motion makes
MAX_LISTED: Final = 6  # directions, of which all choices are listed
TERM: Final = re.compile(
    r"\s*([+-]?)\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)?\s*\*?\s*([A-Za-z_]\w*)\s*"
)
NO_TERM: Final = 1e-12  # of the largest coefficient: not written
MOTIONS: Final = {"M": "V_dot", "B": "V", "K": "X"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Specification(Result):
    """Check of a specification against the environment F = G y + F0, with y the motion that its force depends on.

    Args:
        G: (n, n) damping, stiffness or inertia.
        F0: (n,) force where y is zero.
        names: (2n,) of the motions, then of the forces.
        given: The specified quantities, as text.
        rows: (m, 2n) of them, over the motions and the forces.
        values: (m,) of them; None where they were left out.
        reason: Why the specification is not admissible; empty where it is.
        smallest: Smallest singular value of the specified rows, each scaled to length 1; 0 where they are dependent.
    """

    G: Float64Array
    F0: Float64Array
    names: tuple[str, ...]
    given: tuple[str, ...]
    rows: Float64Array
    values: Float64Array | None
    reason: str
    smallest: float

    @property
    def ok(self) -> bool:
        """The specification is admissible."""
        return not self.reason

    @property
    def warning(self) -> str:
        """A sentence where the specified quantities are nearly dependent; empty where they are not."""
        if not self.ok or self.smallest > NEARLY_DEPENDENT:
            return ""
        return (
            f"{and_list(self.given)} are nearly in the same direction (smallest singular value {self.smallest:.2g}): "
            f"errors of the specified values grow up to {1.0 / self.smallest:.2g} times"
        )

    @property
    def map(self) -> Float64Array:
        """(2n, n) from the specified values to all motions and forces, less `offset`."""
        if not self.ok:
            raise UsageError(f"a specification that is not admissible has no map: {self.reason}", name="map")
        scaled, sizes = _over_motion(self.rows, self.G)
        return np.asarray(_all_quantities(self.G) @ np.linalg.inv(scaled) / sizes)

    @property
    def offset(self) -> Float64Array:
        """(2n,) all motions and forces where the specified values are zero."""
        n = len(self.G)
        return np.asarray(np.append(np.zeros(n), self.F0) - self.map @ (self.rows[:, n:] @ self.F0))

    @property
    def determined(self) -> dict[str, str]:
        """The quantities that the environment determines, each as a sum of the specified ones."""
        map_, offset = self.map, self.offset
        return {
            name: linear_sum(map_[i], self.given, offset[i])
            for i, name in enumerate(self.names)
            if name not in self.given
        }

    @property
    def quantities(self) -> dict[str, float]:
        """The values of all motions and forces, by name."""
        if self.values is None:
            raise UsageError(
                "a specification without values has no quantities; give them, as in {'V1': 0.1, 'F1': 3.0}",
                name="given",
            )
        numbers = self.map @ self.values + self.offset
        return dict(zip(self.names, numbers.tolist(), strict=True))

    def content(self) -> Content:
        """The verdict, and the quantities that the environment determines."""
        title = "specification against a linear environment"
        if not self.ok:
            return Content(title=title, faults=[f"not admissible: {self.reason}"])
        values = self.quantities if self.values is not None else {}
        rows = [(name, text, values.get(name)) for name, text in self.determined.items()]
        return Content(
            title=title,
            summary=[f"{and_list(self.given)}: admissible"],
            tables=[Table(columns=("determined by the environment", "sum", "value"), rows=rows)],
            notes=[self.warning] if self.warning else [],
        )


def check_specification(
    given: Mapping[str, float] | Sequence[str] | Float64Array,
    *,
    values: ArrayLike | None = None,
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

    Rows scaled to length 1 count as dependent where their smallest singular value is below 1e-9, as nearly dependent,
    with a `warning`, below 1e-3; a force below 1e-12 of the environment's largest number counts as one that no motion
    makes. Rows over directions of both metres and radians are compared in the numbers given: scale them alike.

    Args:
        given: Names and values; or names alone; or (m, 2n) rows over the motions and the forces. A name may be a sum,
            such as "2 V1 + V2".
        values: (m,) for names or rows that come without.
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
    force = np.zeros(len(G)) if F0 is None else vector("F0", F0, len(G), unit="N, N m")
    texts, rows, numbers = _read(given, values, names)
    reason, smallest = _checked(G, force, texts, rows)
    return Specification(
        G=read_only(G), F0=read_only(force), names=names, given=texts, rows=rows, values=numbers,
        reason=reason, smallest=smallest,
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
        RangeError: More than 6 directions.

    Example:
        >>> import taut
        >>> len(taut.analysis.possible_specifications(B=[[2, 1], [1, 1]]))
        6
        >>> taut.analysis.possible_specifications(B=[2.0, 0.0])
        (('V1', 'V2'), ('V2', 'F1'))
    """
    G, names = _environment(B=B, K=K, M=M)
    n = len(G)
    if n > MAX_LISTED:
        raise RangeError(
            f"choices are listed for up to {MAX_LISTED} directions; got {n}: ask "
            "taut.analysis.check_specification for one",
            name="B",
        )
    scaled, _ = _over_motion(np.eye(2 * n), G)
    choices = np.array(list(combinations(range(2 * n), n)))
    smallest = np.linalg.svd(scaled[choices], compute_uv=False)[:, -1]
    return tuple(
        tuple(names[i] for i in choice)
        for choice, value in zip(choices.tolist(), smallest, strict=True)
        if value > DEPENDENT
    )


# -------------------------------------------------------------------- the environment and the rows


def _environment(**matrices: ArrayLike | None) -> tuple[Float64Array, tuple[str, ...]]:
    """G (n, n), and the names of the 2n quantities."""
    given = {name: matrix for name, matrix in matrices.items() if matrix is not None}
    if len(given) != 1:
        raise UsageError(
            f"a linear environment takes one of B, K and M, and F0= for the rest; got "
            f"{and_list(list(given)) if given else 'none'}",
            name="B",
        )
    ((name, value),) = given.items()
    G = finite_array(name, value)
    n = len(G) if G.ndim else 1
    if G.shape not in ((), (n,), (n, n)):
        raise ShapeError(f"{name} must be a number, (n,) or (n, n); got shape {G.shape}", name=name)
    G = G if G.ndim == 2 else np.diag(np.broadcast_to(G, (n,)))
    return G, tuple(f"{symbol}{i + 1}" for symbol in (MOTIONS[name], "F") for i in range(n))


def _all_quantities(G: Float64Array) -> Float64Array:
    """(2n, n) from y to all quantities, less F0."""
    return np.vstack([np.eye(len(G)), G])


def _over_motion(rows: Float64Array, G: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(m, n) rows over all quantities as rows over y, each of length 1 or 0; and their lengths."""
    n = len(G)
    full = rows @ _all_quantities(G)
    largest = max(float(np.abs(G).max()), 1e-300)
    rounding = NO_FORCE * (np.abs(rows[:, :n]).sum(axis=1) + largest * np.abs(rows[:, n:]).sum(axis=1))
    sizes = np.linalg.norm(full, axis=1)
    sizes = np.where(sizes <= rounding, 0.0, sizes)
    return np.divide(full, sizes[:, None], out=np.zeros_like(full), where=sizes[:, None] > 0.0), sizes


def _read(
    given: Mapping[str, float] | Sequence[str] | Float64Array, values: ArrayLike | None, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Float64Array, Float64Array | None]:
    """The specified quantities as text, as rows, and their values."""
    if isinstance(given, Mapping):
        if values is not None:
            raise UsageError("given has names and values already; leave out values=", name="values")
        values = [finite_scalar(f"given[{text!r}]", value) for text, value in given.items()]
        given = list(given)
    if isinstance(given, Sequence) and not isinstance(given, str) and all(isinstance(each, str) for each in given):
        texts = tuple(" ".join(text.split()) for text in given)
        rows = np.array([coefficients_of(text, names, "the environment", "quantity") for text in texts])
    elif isinstance(given, (Sequence, np.ndarray)) and not isinstance(given, str):
        rows = finite_array("given", given)
        if rows.ndim != 2 or rows.shape[1] != len(names):
            raise ShapeError(
                f"given must have rows of {len(names)} numbers, over {and_list(names)}; got shape {rows.shape}",
                name="given",
            )
        texts = tuple(linear_sum(row, names) for row in rows)
    else:
        raise UsageError(
            f"given must be names, names with values as {{'V1': 0.1}}, or rows of numbers; got {given!r}",
            name="given",
        )
    numbers = None if values is None else vector("values", values, len(texts))
    return texts, read_only(rows.reshape(len(texts), len(names))), numbers


def _checked(G: Float64Array, F0: Float64Array, texts: Sequence[str], rows: Float64Array) -> tuple[str, float]:
    """The reason why rows are not admissible, or none; and their smallest singular value."""
    n, m = len(G), len(rows)
    scaled, _ = _over_motion(rows, G)
    smallest = float(np.linalg.svd(scaled, compute_uv=False)[-1]) if 0 < m <= n else 0.0
    if m > n:
        return f"n = {count_of(n, 'freedom')}, got {m}: {and_list(texts)}; leave out {m - n}", 0.0
    if m and smallest <= DEPENDENT:
        return _relation(G, F0, texts, rows), smallest
    if m < n:
        got = f"{m}: {and_list(texts)}" if m else "none"
        return f"n = {count_of(n, 'freedom')}, got {got}; specify {n - m} more", smallest
    return "", smallest


def _relation(G: Float64Array, F0: Float64Array, texts: Sequence[str], rows: Float64Array) -> str:
    """The first of the rows that depends on those before it, and how."""
    scaled, sizes = _over_motion(rows, G)
    forces = rows[:, len(G) :] @ F0
    for last in range(len(rows)):
        left, values, _ = np.linalg.svd(scaled[: last + 1])
        if values[-1] > DEPENDENT and last < len(rows) - 1:
            continue
        if not sizes[last]:
            always = linear_sum(np.zeros(0), [], forces[last])
            return f"{texts[last]} is {always} in this environment, whatever the motion"
        weights = left[: last + 1, last] / sizes[: last + 1]
        factors = np.where(np.abs(left[: last + 1, last]) > DEPENDENT, -weights / weights[last], 0.0)[:last]
        constant = float(forces[last] - factors @ forces[:last])
        constant = 0.0 if abs(constant) <= 1e-12 * float(np.abs(forces).max()) else constant
        among = [text for text, factor in zip(texts[:last], factors, strict=True) if factor]
        return (
            f"{and_list([*among, texts[last]])} are dependent, for {texts[last]} = "
            f"{linear_sum(factors, texts[:last], constant)} in this environment; leave one out"
        )
    raise AssertionError("there are rows")


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
    smallest = NO_TERM * max(float(np.abs(coefficients).max(initial=0.0)), 1e-300)
    terms = [(c, name) for c, name in zip(coefficients, names, strict=True) if abs(c) > smallest]
    alone = not constant and len(terms) == 1 and terms[0][0] > 0.0
    text = ""
    for c, name in terms:
        size = f"{abs(c):.6g}"
        factor = f"({name})" if " " in name and not (alone and size == "1") else name
        text += _sign(c, text) + (factor if size == "1" else f"{size} {factor}")
    if constant or not text:
        text += _sign(constant, text) + f"{abs(constant):.6g}"
    return text


def _sign(number: float, before: str) -> str:
    if before:
        return " - " if number < 0.0 else " + "
    return "-" if number < 0.0 else ""


def and_list(words: Sequence[str]) -> str:
    """Words joined by commas and an "and"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
