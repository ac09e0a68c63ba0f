"""Poses in law code: what is read of them is traced, and cannot be written to."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused

import taut

ARM = taut.load_arm("planar3")
Q, V, REF = ARM.home + 0.1, np.array([0.1, -0.2, 0.3]), taut.JointMotion(q=ARM.home)


class ByMatrix(taut.Law):
    """A spring on the entries of the tool's homogeneous matrix."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        T = x.T().matrix
        both = (x.T().inverse() @ x.T()).matrix
        point = np.sin(T @ np.array([0.1, 0.2, 0.3, 1.0]))[:3]
        return taut.Torque(P=x.J()[:3].T @ point + np.sqrt(np.sum(T * T)) + np.sum(both, axis=0)[:3])


class Writing(taut.Law):
    """Changes the pose that the snapshot keeps for everybody."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        x.T().p[2] = 0.0
        return taut.Torque(P=x.q)


def test_the_matrix_of_a_pose_is_traced_as_a_law_reads_it() -> None:
    native, plain = (taut.compile(ByMatrix(), ARM, engine=engine) for engine in ("native", "float"))
    np.testing.assert_allclose(native.step(Q, V, REF), plain.step(Q, V, REF), rtol=1e-12)
    T = taut.snapshot(ARM, q=Q).T().matrix
    assert T.dtype == np.float64
    np.testing.assert_array_equal(T[3], [0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("engine", ["native", "float"])
def test_a_law_cannot_change_the_pose_that_others_read(engine: str) -> None:
    with refused(taut.errors.UsageError):
        taut.compile(Writing(), ARM, engine=engine)  # type: ignore[arg-type]
