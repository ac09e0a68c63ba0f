"""The mode of an oscillation: how joints and terms swing together at one line, and what gains are to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.lines import Swing
from taut.base.types import Array, Float64Array

__all__ = ["Mode"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """A line of a run as a motion of all joints: with the shape phi, gains are numbers of phi^H K phi / phi^H M phi.

    Of gains of a joint each, and of those that a mass matrix or a Jacobian mixes, they are what the mode feels.
    Without a model the joint where the line is strongest stands for all.
    """

    case: Case
    found: Swing

    @cached_property
    def _basis(self) -> Float64Array:
        """(k, 4) growing cosine and sine, and trend, in the window."""
        line, k = self.found.line, self.found.window.stop - self.found.window.start
        t = (np.arange(k) - 0.5 * (k - 1)) * self.case.dt
        grown = np.exp(line.growth * t)
        columns = [grown * np.cos(line.omega * t), grown * np.sin(line.omega * t), np.ones(k), t / max(t[-1], 1e-300)]
        return np.column_stack(columns)

    def phasors(self, x: Float64Array, *, behind: bool = False) -> Array:
        """(n,) complex amplitudes of the line in the columns of x (k, n).

        Args:
            x: What swings, over the run.
            behind: Whether the first tick of the window is left out.
        """
        first = int(behind)
        window = slice(self.found.window.start + first, self.found.window.stop)
        a, b = np.linalg.lstsq(self._basis[first:], x[window], rcond=None)[0][:2]
        out = a - 1j * b
        if self.case.model is None:
            out = np.where(np.arange(self.case.n) == self.found.joint, out, 0.0)
        return np.asarray(out)

    @cached_property
    def q(self) -> Array:
        """(n,) of the joints."""
        return self.phasors(self.case.run.q)

    @cached_property
    def v(self) -> Array:
        """(n,) of their speeds."""
        return self.phasors(self.case.run.v)

    @cached_property
    def M(self) -> Float64Array | None:
        """(n, n) mass matrix where the window begins."""
        return None if self.case.model is None else self.case.model.mass_matrix(self.found.window.start)

    def per_inertia(self, torque: Array, motion: Array) -> float:
        """Part of a torque in phase with a motion, over the inertia that it moves; NaN where that is not known."""
        if self.M is None:
            return math.nan
        inertia = float((np.conj(motion) @ self.M @ motion).real)
        return float((np.conj(motion) @ torque).real) / inertia if inertia > 0.0 else math.nan

    def _term(self, name: str) -> Array:
        terms = self.case.run.terms
        return self.phasors(terms[name]) if name in terms else np.zeros(self.case.n, dtype=complex)

    @cached_property
    def stiffness(self) -> float:
        """[1/s^2] of the spring P."""
        return -self.per_inertia(self._term("P"), self.q)

    @cached_property
    def damping(self) -> float:
        """[1/s] of the damping D."""
        return -self.per_inertia(self._term("D"), self.v)

    @cached_property
    def damping_in_all(self) -> float:
        """[1/s] of the damping D along the whole motion of the window, through which the inertia may change."""
        w, run = self.found.window, self.case.run
        e_dot = -run.v if self.case.error_rate is None else self.case.error_rate
        if self.case.model is None or "D" not in run.terms:
            return math.nan
        M = np.array([self.case.model.mass_matrix(k) for k in range(w.start, w.stop)])
        inertia = float(np.einsum("ki,kij,kj->", e_dot[w], M, e_dot[w]))
        return float(np.sum(e_dot[w] * run.terms["D"][w])) / inertia if inertia > 0.0 else math.nan

    @cached_property
    def friction(self) -> float:
        """[1/s] of the viscous friction that the motion showed."""
        fit = self.case.fit
        return 0.0 if fit is None else self.per_inertia(fit.viscous * self.v, self.v)

    @cached_property
    def integral(self) -> float:
        """[1/s^3] of the integral: how fast it rises, over the error."""
        run, error = self.case.run, self.case.error
        if error is None or "I" not in run.terms:
            return math.nan
        rate = np.zeros_like(run.q)
        rate[1:] = np.diff(run.terms["I"], axis=0) / self.case.dt
        return self.per_inertia(self.phasors(rate, behind=True), self.phasors(error, behind=True))

    @cached_property
    def late(self) -> float:
        """[s] by which torques come after commands, less than a period of the line."""
        run = self.case.run
        there = np.arange(self.case.n) == self.found.joint
        asked, given = (self.phasors(x)[there][0] for x in (run.command, run.tau))
        return float((-np.angle(given / asked) if asked else 0.0) % (2.0 * math.pi)) / self.found.line.omega
