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
        assert answer.json()["tables"][""][0] == {
            "determined by the environment": "V2", "sum": "-2 V1 + F1", "value": None,
        }  # fmt: skip

    @pytest.mark.parametrize("order", [("F1", "2 V1 + V2"), ("2 V1 + V2", "F1")])
    def test_a_force_is_refused_together_with_the_motion_in_its_direction(self, order: tuple[str, str]) -> None:
        answer = taut.analysis.check_specification(order, B=DAMPER)
        assert not answer.ok
        assert answer.smallest < 1e-15
        assert f"{order[1]} = {order[0]} in this environment" in answer.reason
        assert answer.reason in str(answer)

    def test_all_six_pairs_are_listed(self) -> None:
        assert list(taut.analysis.possible_specifications(B=DAMPER)) == PAIRS

    def test_without_coupling_a_force_and_the_motion_along_it_are_not_listed(self) -> None:
        assert taut.analysis.possible_specifications(B=[2.0, 1.0]) == (
            ("V1", "V2"), ("V1", "F2"), ("V2", "F1"), ("F1", "F2"),
        )  # fmt: skip

    def test_it_is_warned_of_what_is_nearly_in_the_same_direction(self) -> None:
        answer = taut.analysis.check_specification({"F1": 1.0, "2 V1 + 1.0001 V2": 1.0}, B=DAMPER)
        assert answer.ok
        assert answer.smallest == pytest.approx(2.8e-5, rel=0.02)
        assert "up to 3.5e+04 times" in answer.warning
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
            (taut.analysis.check_specification(rows, values=values, B=B, F0=K @ X), B, K @ X),
            (taut.analysis.check_specification(rows, values=values, M=M, F0=B @ V + K @ X), M, B @ V + K @ X),
            (taut.analysis.check_specification(rows, values=values, K=K, F0=X), K, X),
        ):
            got = np.array(list(answer.quantities.values()))
            np.testing.assert_allclose(got, all_of(G, F0, rows, values), rtol=1e-9)

    def test_the_reason_knows_what_the_spring_pushes_with(self) -> None:
        answer = taut.analysis.check_specification(["F1", "2 V1 + V2"], B=DAMPER, F0=[1.0, 2.0])
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
            (["V1", "V2", "F1"], "n = 2 freedoms, got 3"),
            (["V1"], "n = 2 freedoms, got 1"),
            ([], "n = 2 freedoms, got none"),
            (["V1", "V1"], "V1 and V1 are dependent"),
            (["F1 - 2 V1 - V2", "V1"], "F1 - 2 V1 - V2 is 0 in this environment"),
        ],
    )
    def test_what_is_not_admissible_has_a_reason(self, given: list[str], reason: str) -> None:
        answer = taut.analysis.check_specification(given, B=DAMPER)
        assert not answer.ok
        assert answer.reason.startswith(reason)

    def test_a_force_that_no_motion_makes_is_not_admissible(self) -> None:
        answer = taut.analysis.check_specification(["F2", "V1"], B=[1.0, 0.0], F0=[0.0, 6.0])
        assert answer.reason.startswith("F2 is 6 in this environment")

    @pytest.mark.parametrize(
        ("words", "error", "name"),
        [
            ({}, taut.errors.UsageError, "B"),
            ({"B": DAMPER, "K": 1.0}, taut.errors.UsageError, "B"),
            ({"B": np.ones((2, 3))}, taut.errors.ShapeError, "B"),
            ({"B": DAMPER, "F0": [1.0]}, taut.errors.ShapeError, "F0"),
            ({"B": [[1.0, np.nan]]}, taut.errors.RangeError, "B"),
            ({"B": DAMPER, "given": ["V1", "V3"]}, taut.errors.UnknownNameError, "V3"),
            ({"B": DAMPER, "given": ["V1", "2 * + V2"]}, taut.errors.UsageError, "given"),
            ({"B": DAMPER, "given": [""]}, taut.errors.UsageError, "given"),
            ({"B": DAMPER, "given": {"V1": 1.0}, "values": [1.0]}, taut.errors.UsageError, "values"),
            ({"B": DAMPER, "given": np.eye(3)}, taut.errors.ShapeError, "given"),
            ({"B": DAMPER, "given": "V1"}, taut.errors.UsageError, "given"),
            ({"B": DAMPER, "given": {"V1": np.inf}}, taut.errors.RangeError, "given"),
            ({"B": DAMPER, "values": [1.0]}, taut.errors.ShapeError, "values"),
        ],
    )
    def test_bad_input_is_refused_by_name(
        self, words: dict[str, object], error: type[taut.TautError], name: str
    ) -> None:
        words = {"given": ["V1", "F1"], **words}
        with pytest.raises(error) as caught:
            taut.analysis.check_specification(**words)  # type: ignore[arg-type]
        assert name in (caught.value.name or "") or name in str(caught.value)

    def test_a_refused_specification_has_no_map_and_one_without_values_no_quantities(self) -> None:
        with pytest.raises(taut.errors.UsageError):
            _ = taut.analysis.check_specification(["V1"], B=DAMPER).map
        with pytest.raises(taut.errors.UsageError):
            _ = taut.analysis.check_specification(["V1", "V2"], B=DAMPER).quantities

    def test_choices_are_listed_for_up_to_six_directions(self) -> None:
        with pytest.raises(taut.errors.RangeError):
            taut.analysis.possible_specifications(B=np.eye(7))
