"""What may be specified against a linear environment: n of the 2n motions and forces, section 10.4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from taut.base.checks import finite_array, finite_scalar, read_only, vector
from taut.base.errors import RangeError, ShapeError, UsageError, count_of
from taut.base.types import ArrayLike, Float64Array
from taut.linear.linear_environment import LinearEnvironment
from taut.linear.linear_words import and_list, combination, written

__all__ = ["Specification", "check_specification", "possible_specifications"]

DEPENDENT: Final = 1e-9  # smallest singular value of what is given, each row scaled to length 1
NEARLY: Final = 1e-3
MOST: Final = 6  # directions, of which all choices are listed


@dataclass(frozen=True, kw_only=True, eq=False)
class Specification:
    """Whether some motions and forces may be chosen; print it for a sentence.

    Args:
        environment: Against which.
        given: What is to be chosen, in words.
        rows: (m, 2n) of it, over the motions and the forces.
        values: (m,) of it; None where they were left out.
        reason: Why it may not be; empty where it may.
        smallest: The smallest singular value of what is given, each row scaled to length 1: 0 where it is dependent.
    """

    environment: LinearEnvironment
    given: tuple[str, ...]
    rows: Float64Array
    values: Float64Array | None
    reason: str
    smallest: float

    @property
    def ok(self) -> bool:
        """Whether it may be chosen."""
        return not self.reason

    @property
    def warning(self) -> str:
        """That it is close to what may not be; empty where it is not."""
        if not self.ok or self.smallest > NEARLY:
            return ""
        return (
            f"{and_list(self.given)} are nearly in the same direction (smallest singular value {self.smallest:.2g}): "
            f"errors of what is given grow up to {1.0 / self.smallest:.2g} times"
        )

    @property
    def map(self) -> Float64Array:
        """(2n, n) from what is given to all motions and forces, less `offset`."""
        self._must_be_ok("map")
        felt, sizes = self.environment.felt(self.rows)
        return np.asarray(self.environment.all @ np.linalg.inv(felt) / sizes)

    @property
    def offset(self) -> Float64Array:
        """(2n,) all motions and forces where what is given is zero."""
        n = self.environment.n
        own = np.append(np.zeros(n), self.environment.F0)
        return np.asarray(own - self.map @ (self.rows[:, n:] @ self.environment.F0))

    @property
    def determined(self) -> dict[str, str]:
        """What the environment determines, each as a sum of what is given."""
        map_, offset = self.map, self.offset
        return {
            name: written(map_[i], self.given, offset[i])
            for i, name in enumerate(self.environment.names)
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
        return dict(zip(self.environment.names, numbers.tolist(), strict=True))

    def _must_be_ok(self, name: str) -> None:
        if not self.ok:
            raise UsageError(f"a specification that is refused has no {name}: {self.reason}", name=name)

    def __str__(self) -> str:
        if not self.ok:
            return self.reason
        words = []
        for name, text in self.determined.items():
            number = "" if self.values is None else f" = {self.quantities[name]:.6g}"
            words.append(f"{name} = {text}{number}")
        sentence = f"{and_list(self.given)} may be chosen; the environment determines {and_list(words)}"
        return "\n".join(each for each in (sentence, self.warning) if each)


def check_specification(
    given: Mapping[str, float] | Sequence[str] | Float64Array,
    *,
    values: ArrayLike | None = None,
    B: ArrayLike | None = None,
    K: ArrayLike | None = None,
    M: ArrayLike | None = None,
    X: ArrayLike | None = None,
    V: ArrayLike | None = None,
    axes: Sequence[str] | None = None,
) -> Specification:
    """Which motions and forces may be chosen against a linear environment, and what that makes of the others.

    Law:          F = M V_dot + B V + K X: n directions have n freedoms among their 2n motions and forces. What is
                    chosen, S (y, F) = s with F = G y + F0, must have S (I; G) of rank n                 section 10.4

    y is the highest rate that the environment feels: V_dot with M, else V with B, else X with K; lower ones are known
    at that instant. Quantities are called V1, V2, ..., F1, F2, ...; or V_x, ..., with `axes`. F is what is applied to
    the environment, F_app.

    Rows scaled to length 1 count as dependent where their smallest singular value is below 1e-9, as nearly so, with a
    `warning`, below 1e-3; a force below 1e-12 of the environment's largest number counts as one that no motion makes.
    Rows over directions of both metres and radians are compared in the numbers given: scale them alike.

    Args:
        given: Names and values; or names alone; or (m, 2n) rows over the motions and the forces. A name may be a sum,
            such as "2 V1 + V2".
        values: (m,) for names or rows that come without.
        B: Damping, a number, (n,) or (n, n), symmetric or not.
        K: Stiffness, likewise.
        M: Inertia, likewise.
        X: (n,) displacement at that instant, where K stands beside B or M.
        V: (n,) velocity at that instant, where B stands beside M.
        axes: (n,) names of the directions.

    Raises:
        UsageError: No environment, or one without what it needs; a sum that cannot be read.
        UnknownNameError: A quantity that there is not.
        ShapeError, RangeError: Matrices of different sizes, numbers that are not finite.

    Example:
        >>> import taut
        >>> print(taut.analysis.check_specification({"V1": 0.1, "F1": 3.0}, B=[[2, 1], [1, 1]]))
        V1 and F1 may be chosen; the environment determines V2 = -2 V1 + F1 = 2.8 and F2 = -V1 + F1 = 2.9
        >>> taut.analysis.check_specification(["F1", "2 V1 + V2"], B=[[2, 1], [1, 1]]).ok
        False
    """
    environment = LinearEnvironment.of(B=B, K=K, M=M, X=X, V=V, axes=axes)
    words, rows, numbers = _read(given, values, environment)
    reason, smallest = _judged(environment, words, rows)
    return Specification(
        environment=environment, given=words, rows=rows, values=numbers, reason=reason, smallest=smallest
    )


def _read(
    given: Mapping[str, float] | Sequence[str] | Float64Array,
    values: ArrayLike | None,
    environment: LinearEnvironment,
) -> tuple[tuple[str, ...], Float64Array, Float64Array | None]:
    """What is given in words, as rows, and its values."""
    names = environment.names
    if isinstance(given, Mapping):
        if values is not None:
            raise UsageError(
                "values stand in given already, which has names and values; give them once", name="values"
            )
        numbers = [finite_scalar(f"given[{text!r}]", value) for text, value in given.items()]
        values, given = numbers, list(given)
    if isinstance(given, Sequence) and not isinstance(given, str) and all(isinstance(each, str) for each in given):
        words = tuple(" ".join(text.split()) for text in given)
        rows = np.array([combination(text, names, "the environment", "quantity") for text in words])
    elif isinstance(given, (Sequence, np.ndarray)) and not isinstance(given, str):
        rows = finite_array("given", given)
        if rows.ndim != 2 or rows.shape[1] != len(names):
            raise ShapeError(
                f"given must have rows of {len(names)} numbers, over {and_list(names)}; got shape {rows.shape}",
                name="given",
            )
        words = tuple(written(row, names) for row in rows)
    else:
        raise UsageError(
            f"given must be names, names with values as {{'V1': 0.1}}, or rows of numbers; got {given!r}",
            name="given",
        )
    numbers_ = None if values is None else vector("values", values, len(words))
    return words, read_only(rows.reshape(len(words), len(names))), numbers_


def _judged(environment: LinearEnvironment, words: Sequence[str], rows: Float64Array) -> tuple[str, float]:
    """Why rows may not be chosen, or nothing; and their smallest singular value."""
    n, m = environment.n, len(rows)
    felt, _ = environment.felt(rows)
    smallest = float(np.linalg.svd(felt, compute_uv=False)[-1]) if 0 < m <= n else 0.0
    if m > n:
        return f"n = {count_of(n, 'freedom')}, got {m}: {and_list(words)}; leave out {_number(m - n)}", 0.0
    if m and smallest <= DEPENDENT:
        return _relation(environment, words, rows), smallest
    if m < n:
        more = _completing(environment, rows)
        got = f"{m}: {and_list(words)}" if m else "none"
        return (
            f"n = {count_of(n, 'freedom')}, got {got}; choose {_number(n - m)} more, such as {and_list(more)}",
            smallest,
        )
    return "", smallest


def _number(count: int) -> str:
    return ("one", "two", "three", "four", "five", "six")[count - 1] if count <= 6 else str(count)


def _relation(environment: LinearEnvironment, words: Sequence[str], rows: Float64Array) -> str:
    """Which of the rows depends on those before it, and how."""
    felt, sizes = environment.felt(rows)
    F_part = rows[:, environment.n :] @ environment.F0
    for last in range(len(rows)):
        left, values, _ = np.linalg.svd(felt[: last + 1])
        if values[-1] > DEPENDENT and last < len(rows) - 1:
            continue
        if not sizes[last]:
            always = written(np.zeros(0), [], F_part[last])
            return f"{words[last]} may not be chosen: it is {always} in this environment, whatever the motion"
        weights = left[: last + 1, last] / sizes[: last + 1]
        shares = np.where(np.abs(left[: last + 1, last]) > DEPENDENT, -weights / weights[last], 0.0)[:last]
        constant = float(F_part[last] - shares @ F_part[:last])
        constant = 0.0 if abs(constant) <= 1e-12 * float(np.abs(F_part).max()) else constant
        among = [word for word, share in zip(words[:last], shares, strict=True) if share]
        return (
            f"{and_list([*among, words[last]])} may not be chosen together, for they are in the same direction and "
            f"not independent: {words[last]} = {written(shares, words[:last], constant)} in this environment; leave "
            "one out"
        )
    raise AssertionError("there are rows")


def _completing(environment: LinearEnvironment, rows: Float64Array) -> list[str]:
    """Quantities with which rows are as many as there are freedoms."""
    found: list[str] = []
    taken = rows
    for name, row in zip(environment.names, np.eye(2 * environment.n), strict=True):
        felt, _ = environment.felt(np.vstack([taken, row]))
        if len(taken) < environment.n and np.linalg.svd(felt, compute_uv=False)[-1] > NEARLY:
            found, taken = [*found, name], np.vstack([taken, row])
    return found


def possible_specifications(
    *,
    B: ArrayLike | None = None,
    K: ArrayLike | None = None,
    M: ArrayLike | None = None,
    axes: Sequence[str] | None = None,
) -> tuple[tuple[str, ...], ...]:
    """Every n of the 2n motions and forces that may be chosen together against a linear environment.

    Args:
        B: Damping, a number, (n,) or (n, n); one of B, K and M, the highest rate that the environment feels.
        K: Stiffness, likewise.
        M: Inertia, likewise.
        axes: (n,) names of the directions.

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
    given = [name for name, matrix in (("B", B), ("K", K), ("M", M)) if matrix is not None]
    if len(given) > 1:
        raise UsageError(
            f"possible_specifications takes the matrix of the highest rate alone, for lower ones change nothing; got "
            f"{and_list(given)}: keep {'M' if 'M' in given else 'B'}",
            name=given[1],
        )
    environment = LinearEnvironment.of(B=B, K=K, M=M, X=None, V=None, axes=axes)
    n = environment.n
    if n > MOST:
        raise RangeError(
            f"choices are listed for up to {MOST} directions; got {n}: ask taut.analysis.check_specification for one",
            name="B",
        )
    felt, _ = environment.felt(np.eye(2 * n))
    choices = np.array(list(combinations(range(2 * n), n)))
    smallest = np.linalg.svd(felt[choices], compute_uv=False)[:, -1]
    return tuple(
        tuple(environment.names[i] for i in choice)
        for choice, value in zip(choices.tolist(), smallest, strict=True)
        if value > DEPENDENT
    )
