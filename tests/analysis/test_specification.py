"""Specifications against a linear environment: the chapter's damper, brute force linear algebra, messages."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import scipy.linalg

import taut
from taut.analysis.constraints import linear_sum

DAMPER = [[2.0, 1.0], [1.0, 1.0]]
PAIRS = list(combinations(["V1", "V2", "F1", "F2"], 2))


class TestTheChaptersDamper:
    @pytest.mark.parametrize("pair", PAIRS, ids="-".join)
    def test_any_two_of_its_four_quantities_may_be_specified(self, pair: tuple[str, str]) -> None:
        V = np.array([0.3, -0.7])
        truth = dict(zip(["V1", "V2", "F1", "F2"], [*V, *(np.array(DAMPER) @ V)], strict=True))
        answer = taut.analysis.check_specification({name: truth[name] for name in pair}, B=DAMPER)
        assert answer.ok
        assert answer.quantities == pytest.approx(truth, abs=1e-14)
        assert set(answer.determined) == set(truth) - set(pair)

    def test_one_force_and_one_motion_determine_the_others_as_sums(self) -> None:
        answer = taut.analysis.check_specification(["V1", "F1"], B=DAMPER)
        assert answer.determined == {"V2": "-2 V1 + F1", "F2": "-V1 + F1"}
        assert answer.json()["tables"][""][0] == {
            "determined by the environment": "V2", "sum": "-2 V1 + F1", "value": None,
        }  # fmt: skip

    @pytest.mark.parametrize("order", [("F1", "2 V1 + V2"), ("2 V1 + V2", "F1")])
    def test_a_force_is_refused_together_with_the_motion_in_its_direction(self, order: tuple[str, str]) -> None:
        answer = taut.analysis.check_specification(order, B=DAMPER)
        assert not answer.ok
        assert answer.reason in str(answer)
        assert (answer.quantities, answer.determined) == ({}, {})

    def test_without_coupling_a_force_and_the_motion_along_it_are_not_admissible(self) -> None:
        admissible = {pair for pair in PAIRS if taut.analysis.check_specification(pair, B=[2.0, 1.0]).ok}
        assert admissible == {("V1", "V2"), ("V1", "F2"), ("V2", "F1"), ("F1", "F2")}


class TestLinearEnvironments:
    @pytest.mark.parametrize("n", [1, 3, 6])
    def test_choices_agree_with_brute_force(self, n: int) -> None:
        """Names and sums at random, environments of every rank: accepted where 2n equations have rank 2n."""
        rng = np.random.default_rng(n)
        names = [f"{s}{i + 1}" for s in "VF" for i in range(n)]
        verdicts = []
        for _ in range(60):
            rank = int(rng.integers(0, n + 1))
            G = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, n))
            rows = np.eye(2 * n)[rng.choice(2 * n, n, replace=False)]
            if rng.random() < 0.5:
                rows = rows + rng.integers(-1, 2, size=rows.shape)
            rows = np.unique(rows[np.abs(rows).sum(axis=1) > 0.0], axis=0)
            whole = np.vstack([np.hstack([-G, np.eye(n)]), rows])
            regular = len(rows) == n and np.linalg.matrix_rank(whole, tol=1e-9) == 2 * n
            values = rng.normal(size=len(rows))
            given = {linear_sum(row, names): value for row, value in zip(rows, values, strict=True)}
            answer = taut.analysis.check_specification(given, B=G)
            verdicts.append(regular)
            assert answer.ok == regular, answer
            if answer.ok:
                expected = scipy.linalg.solve(whole, np.concatenate([np.zeros(n), values]))
                got = np.array(list(answer.quantities.values()))
                np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-7)
        assert 5 < sum(verdicts) < 55

    @pytest.mark.parametrize("scale", [1e-9, 1e9])
    def test_the_unit_of_the_forces_changes_no_verdict(self, scale: float) -> None:
        B = scale * np.array(DAMPER)
        assert all(taut.analysis.check_specification(pair, B=B).ok for pair in PAIRS)
        assert not taut.analysis.check_specification(["F1", f"{2 * scale} V1 + {scale} V2"], B=B).ok

    def test_rounding_makes_no_force_where_the_environment_makes_none(self) -> None:
        """A damper in one direction, rotated: what remains of 0 in the other is rounding, here 1e-16 of the largest."""
        for angle, refused in ((1.1, ["F1", "F2"]), (np.pi / 2, ["F1", "V1"])):
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s], [s, c]])
            B = turn @ np.diag([2.0, 0.0]) @ turn.T
            assert B.all()
            assert not taut.analysis.check_specification(refused, B=B).ok
            assert taut.analysis.check_specification(["V1", "F2"], B=B).ok

    def test_a_determined_quantity_is_written_with_what_is_given_in_brackets(self) -> None:
        assert taut.analysis.check_specification(["F1 - V2", "V2"], B=DAMPER).determined == {
            "V1": "0.5 (F1 - V2)", "F1": "(F1 - V2) + V2", "F2": "0.5 (F1 - V2) + V2",
        }  # fmt: skip


@pytest.mark.parametrize("given", [["V1", "V2", "F1"], ["V1"], [], ["V1", "V1"], ["F1 - 2 V1 - V2", "V1"]])
def test_too_many_too_few_and_dependent_quantities_are_not_admissible(given: list[str]) -> None:
    assert not taut.analysis.check_specification(given, B=DAMPER).ok


@pytest.mark.parametrize(
    ("words", "error", "name"),
    [
        ({}, taut.errors.UsageError, "B"),
        ({"B": 2.0}, taut.errors.ShapeError, "B"),
        ({"B": np.ones((2, 3))}, taut.errors.ShapeError, "B"),
        ({"B": [[1.0, np.nan]]}, taut.errors.RangeError, "B"),
        ({"B": DAMPER, "given": ["V1", "V3"]}, taut.errors.UnknownNameError, "V3"),
        ({"B": DAMPER, "given": ["V1", "2 * + V2"]}, taut.errors.UsageError, "given"),
        ({"B": DAMPER, "given": [""]}, taut.errors.UsageError, "given"),
        ({"B": DAMPER, "given": np.eye(3)}, taut.errors.UsageError, "given"),
        ({"B": DAMPER, "given": "V1"}, taut.errors.UsageError, "given"),
        ({"B": DAMPER, "given": {"V1": np.inf}}, taut.errors.RangeError, "given"),
    ],
)
def test_bad_input_is_refused_by_name(words: dict[str, object], error: type[taut.TautError], name: str) -> None:
    words = {"given": ["V1", "F1"], **words}
    with pytest.raises(error) as caught:
        taut.analysis.check_specification(**words)  # type: ignore[arg-type]
    assert name in (caught.value.name or "") or name in str(caught.value)
