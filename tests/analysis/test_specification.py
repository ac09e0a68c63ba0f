"""What may be specified against a linear environment: the chapter's damper, brute force linear algebra, messages."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import scipy.linalg

import taut

DAMPER = [[2.0, 1.0], [1.0, 1.0]]
PAIRS = list(combinations(["V1", "V2", "F1", "F2"], 2))


def all_of(G: np.ndarray, F0: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Motions and forces by one system of 2n equations: F - G y = F0 and what is given."""
    n = len(F0)
    return scipy.linalg.solve(np.vstack([np.hstack([-G, np.eye(n)]), rows]), np.concatenate([F0, values]))


class TestTheChaptersDamper:
    @pytest.mark.parametrize("pair", PAIRS, ids="-".join)
    def test_any_two_of_its_four_quantities_may_be_chosen(self, pair: tuple[str, str]) -> None:
        V = np.array([0.3, -0.7])
        truth = dict(zip(["V1", "V2", "F1", "F2"], [*V, *(np.array(DAMPER) @ V)], strict=True))
        answer = taut.analysis.check_specification({name: truth[name] for name in pair}, B=DAMPER)
        assert answer.ok
        assert not answer.warning
        assert answer.quantities == pytest.approx(truth, abs=1e-14)
        assert set(answer.determined) == set(truth) - set(pair)

    def test_one_force_and_one_motion_determine_the_others_as_sums(self) -> None:
        answer = taut.analysis.check_specification(["V1", "F1"], B=DAMPER)
        assert answer.determined == {"V2": "-2 V1 + F1", "F2": "-V1 + F1"}
        assert str(answer) == "V1 and F1 may be chosen; the environment determines V2 = -2 V1 + F1 and F2 = -V1 + F1"

    @pytest.mark.parametrize("order", [("F1", "2 V1 + V2"), ("2 V1 + V2", "F1")])
    def test_a_force_is_refused_together_with_the_motion_in_its_direction(self, order: tuple[str, str]) -> None:
        answer = taut.analysis.check_specification(order, B=DAMPER)
        assert not answer.ok
        assert answer.smallest < 1e-15
        assert str(answer) == (
            f"{order[0]} and {order[1]} may not be chosen together, for they are in the same direction and not "
            f"independent: {order[1]} = {order[0]} in this environment; leave one out"
        )

    def test_all_six_pairs_are_listed(self) -> None:
        assert list(taut.analysis.possible_specifications(B=DAMPER)) == PAIRS

    def test_without_coupling_a_force_and_the_motion_along_it_are_not_listed(self) -> None:
        assert taut.analysis.possible_specifications(B=[2.0, 1.0], axes=("x", "y")) == (
            ("V_x", "V_y"), ("V_x", "F_y"), ("V_y", "F_x"), ("F_x", "F_y"),
        )  # fmt: skip

    def test_it_is_warned_of_what_is_nearly_in_the_same_direction(self) -> None:
        answer = taut.analysis.check_specification({"F1": 1.0, "2 V1 + 1.0001 V2": 1.0}, B=DAMPER)
        assert answer.ok
        assert answer.warning == (
            "F1 and 2 V1 + 1.0001 V2 are nearly in the same direction (smallest singular value 2.8e-05): errors of what "
            "is given grow up to 3.5e+04 times"
        )
        assert str(answer).endswith(answer.warning)


class TestLinearEnvironments:
    @pytest.mark.parametrize("n", [1, 2, 3, 6])
    def test_choices_agree_with_brute_force(self, n: int) -> None:
        """Names and sums at random, environments of every rank: accepted where 2n equations have rank 2n."""
        rng = np.random.default_rng(n)
        verdicts = []
        for _ in range(60):
            rank = int(rng.integers(0, n + 1))
            G = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, n))
            rows = np.eye(2 * n)[rng.choice(2 * n, n, replace=False)]
            if rng.random() < 0.5:
                rows = rows + rng.integers(-1, 2, size=rows.shape)
            rows = rows[np.abs(rows).sum(axis=1) > 0.0]
            whole = np.vstack([np.hstack([-G, np.eye(n)]), rows])
            regular = len(rows) == n and np.linalg.matrix_rank(whole, tol=1e-9) == 2 * n
            values = rng.normal(size=len(rows))
            answer = taut.analysis.check_specification(rows, values=values, B=G) if len(rows) else None
            verdicts.append(regular)
            assert (answer is not None and answer.ok) == regular, answer
            if answer is not None and answer.ok:
                expected = all_of(G, np.zeros(n), rows, values)
                got = np.array(list(answer.quantities.values()))
                np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-9 / answer.smallest)
        assert 5 < sum(verdicts) < 55

    def test_the_listed_choices_are_those_that_are_accepted_one_by_one(self) -> None:
        rng = np.random.default_rng(5)
        B = rng.integers(-1, 2, size=(3, 3)).astype(float)
        names = [f"{s}{i}" for s in "VF" for i in (1, 2, 3)]
        one_by_one = [c for c in combinations(names, 3) if taut.analysis.check_specification(c, B=B).ok]
        assert list(taut.analysis.possible_specifications(B=B)) == one_by_one
        assert 1 < len(one_by_one) < 20

    def test_a_spring_beside_the_damper_adds_what_it_pushes_with_now(self) -> None:
        rng = np.random.default_rng(2)
        M, B, K = rng.normal(size=(3, 3, 3))
        X, V, values = rng.normal(size=(3, 3))
        rows = rng.normal(size=(3, 6))
        for answer, G, F0 in (
            (taut.analysis.check_specification(rows, values=values, B=B, K=K, X=X), B, K @ X),
            (taut.analysis.check_specification(rows, values=values, M=M, B=B, K=K, X=X, V=V), M, B @ V + K @ X),
            (taut.analysis.check_specification(rows, values=values, M=M, K=K, X=X), M, K @ X),
        ):
            got = np.array(list(answer.quantities.values()))
            np.testing.assert_allclose(got, all_of(G, F0, rows, values), rtol=1e-9)

    def test_the_reason_knows_what_the_spring_pushes_with(self) -> None:
        answer = taut.analysis.check_specification(["F1", "2 V1 + V2"], B=DAMPER, K=1.0, X=[1.0, 2.0])
        assert "2 V1 + V2 = F1 - 1 in this environment" in answer.reason

    def test_of_a_spring_alone_displacements_are_chosen(self) -> None:
        answer = taut.analysis.check_specification({"X1": 0.01, "F2": 5.0}, K=[1000.0, 500.0])
        assert answer.quantities == pytest.approx({"X1": 0.01, "X2": 0.01, "F1": 10.0, "F2": 5.0})

    def test_a_mass_alone_is_pushed_by_its_acceleration(self) -> None:
        assert taut.analysis.check_specification({"V_dot1": 2.0}, M=3.0).quantities["F1"] == pytest.approx(6.0)

    @pytest.mark.parametrize("scale", [1e-9, 1e9])
    def test_the_unit_of_the_forces_changes_no_verdict(self, scale: float) -> None:
        B = scale * np.array(DAMPER)
        assert all(taut.analysis.check_specification(pair, B=B).ok for pair in PAIRS)
        assert not taut.analysis.check_specification(["F1", "2 V1 + V2"], B=B).ok

    def test_rounding_makes_no_force_where_the_environment_makes_none(self) -> None:
        """A damper in one direction, turned: what is left of 0 in the other is rounding, here 1e-16 of the largest."""
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


class TestWhatIsRefused:
    @pytest.mark.parametrize(
        ("given", "reason"),
        [
            (["V1", "V2", "F1"], "n = 2 freedoms, got 3: V1, V2 and F1; leave out one"),
            (["V1"], "n = 2 freedoms, got 1: V1; choose one more, such as V2"),
            ([], "n = 2 freedoms, got none; choose two more, such as V1 and V2"),
            (
                ["V1", "V1"],
                "V1 and V1 may not be chosen together, for they are in the same direction and not independent: V1 = V1 "
                "in this environment; leave one out",
            ),
            (
                ["F1 - 2 V1 - V2", "V1"],
                "F1 - 2 V1 - V2 may not be chosen: it is 0 in this environment, whatever the motion",
            ),
        ],
    )
    def test_what_may_not_be_chosen_has_a_reason(self, given: list[str], reason: str) -> None:
        answer = taut.analysis.check_specification(given, B=DAMPER)
        assert (answer.ok, answer.reason, str(answer)) == (False, reason, reason)

    def test_a_force_that_no_motion_makes_may_not_be_chosen(self) -> None:
        answer = taut.analysis.check_specification(["F2", "V1"], B=[1.0, 0.0], K=[0.0, 3.0], X=[1.0, 2.0])
        assert answer.reason == "F2 may not be chosen: it is 6 in this environment, whatever the motion"

    @pytest.mark.parametrize(
        ("words", "error", "text"),
        [
            (
                {},
                taut.errors.UsageError,
                "an environment F = M V_dot + B V + K X needs one of B, K and M, such as B=[[2, 1], [1, 1]]",
            ),
            (
                {"B": DAMPER, "K": 1.0},
                taut.errors.UsageError,
                "K beside B needs X=, the displacement at that instant",
            ),
            ({"M": 1.0, "B": DAMPER}, taut.errors.UsageError, "B beside M needs V=, the velocity at that instant"),
            (
                {"K": DAMPER, "X": [1, 2]},
                taut.errors.UsageError,
                "X is the displacement at that instant, for K beside a higher rate; here it has no part: leave it out",
            ),
            (
                {"B": [1, 2], "M": np.eye(3)},
                taut.errors.ShapeError,
                r"B must be a number, (3,) or (3, 3); got shape (2,)",
            ),
            ({"B": [[1.0, np.nan]]}, taut.errors.RangeError, "B[0, 1] must be finite; got nan"),
            (
                {"B": DAMPER, "axes": ("x", "x")},
                taut.errors.UsageError,
                "axes must be 2 different words, such as ('x', 'y'); got ('x', 'x')",
            ),
            (
                {"B": DAMPER, "given": ["V1", "V3"]},
                taut.errors.UnknownNameError,
                "the environment has no quantity 'V3'; it has 'V1', 'V2', 'F1', 'F2'",
            ),
            (
                {"B": DAMPER, "given": ["V1", "2 * + V2"]},
                taut.errors.UsageError,
                "a quantity is a name or a sum such as '2 V1 + F2'; got '2 * + V2'",
            ),
            (
                {"B": DAMPER, "given": [""]},
                taut.errors.UsageError,
                "a quantity is a name or a sum such as '2 V1 + F2'; got ''",
            ),
            (
                {"B": DAMPER, "given": {"V1": 1.0}, "values": [1.0]},
                taut.errors.UsageError,
                "values stand in given already, which has names and values; give them once",
            ),
            (
                {"B": DAMPER, "given": np.eye(3)},
                taut.errors.ShapeError,
                "given must have rows of 4 numbers, over V1, V2, F1 and F2; got shape (3, 3)",
            ),
            (
                {"B": DAMPER, "given": "V1"},
                taut.errors.UsageError,
                "given must be names, names with values as {'V1': 0.1}, or rows of numbers; got 'V1'",
            ),
            ({"B": DAMPER, "given": {"V1": np.inf}}, taut.errors.RangeError, "given['V1'] must be finite; got inf"),
            ({"B": DAMPER, "values": [1.0]}, taut.errors.ShapeError, "values must have shape (2,); got shape (1,)"),
        ],
    )
    def test_bad_input_is_refused_in_a_sentence(
        self, words: dict[str, object], error: type[Exception], text: str
    ) -> None:
        words = {"given": ["V1", "F1"], **words}
        with pytest.raises(error) as caught:
            taut.analysis.check_specification(**words)  # type: ignore[arg-type]
        assert str(caught.value) == text

    def test_a_refused_specification_has_no_map_and_one_without_values_no_quantities(self) -> None:
        with pytest.raises(
            taut.errors.UsageError, match="a specification that is refused has no map: n = 2 freedoms, got 1"
        ):
            _ = taut.analysis.check_specification(["V1"], B=DAMPER).map
        with pytest.raises(taut.errors.UsageError) as caught:
            _ = taut.analysis.check_specification(["V1", "V2"], B=DAMPER).quantities
        assert str(caught.value) == (
            "a specification without values has no quantities; give them, as in {'V1': 0.1, 'F1': 3.0}"
        )

    def test_choices_are_listed_for_one_matrix_and_up_to_six_directions(self) -> None:
        with pytest.raises(taut.errors.UsageError) as caught:
            taut.analysis.possible_specifications(B=DAMPER, K=DAMPER)
        assert str(caught.value) == (
            "possible_specifications takes the matrix of the highest rate alone, for lower ones change nothing; got B "
            "and K: keep B"
        )
        with pytest.raises(taut.errors.RangeError) as caught2:
            taut.analysis.possible_specifications(B=np.eye(7))
        assert str(caught2.value) == (
            "choices are listed for up to 6 directions; got 7: ask taut.analysis.check_specification for one"
        )
