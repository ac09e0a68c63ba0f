"""Traced arrays: every NumPy function that is allowed gives what it gives on floats, every other one a sentence."""

from __future__ import annotations

import copy
import math
import operator
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from base_tools import traced_value
from refusals import refused

from taut import TautError
from taut import math as tm
from taut.errors import ShapeError, TraceError
from taut.trace.array import Traced, traced_array
from taut.trace.graph import Graph
from taut.trace.scalar import Condition, Scalar, tracing

ROUNDING = 1e-15  # the trace does the operations of NumPy, but sums in another order and divides before it multiplies

A = np.array([0.3, -1.2, 0.7])
B = np.array([0.9, 0.4, -0.7])
M = np.array([[2.0, -0.3, 0.1], [0.2, 1.5, -0.4], [-0.6, 0.3, 1.1]])
N = np.array([[0.5, -1.5, 2.5], [1.0, 0.25, -0.75]])
S = 0.6

Case = tuple[str, Callable[..., Any], tuple[Any, ...]]


def cases_of_ufuncs() -> list[Case]:
    one = {
        np.sin: A,
        np.cos: A,
        np.tan: A,
        np.arcsin: B,
        np.arccos: B,
        np.arctan: A,
        np.exp: A,
        np.log: np.abs(A),
        np.tanh: A,
        np.sqrt: np.abs(A),
        np.floor: 3.0 * A,
        np.ceil: 3.0 * A,
        np.absolute: A,
        np.sign: np.array([0.3, 0.0, -2.0]),
        np.negative: A,
        np.positive: A,
        np.square: A,
        np.conjugate: A,
        np.deg2rad: A,
        np.radians: A,
        np.rad2deg: A,
        np.degrees: A,
        np.logical_not: np.array([0.3, 0.0, -2.0]),
    }
    two = {
        np.add: (A, B),
        np.subtract: (A, B),
        np.multiply: (A, B),
        np.divide: (A, B),
        np.minimum: (A, B),
        np.maximum: (A, B),
        np.arctan2: (A, B),
        np.hypot: (A, B),
        np.power: (np.abs(A), B),
        np.remainder: (A, B),
        np.floor_divide: (3.0 * A, B),
        np.less: (A, B),
        np.less_equal: (A, -B),
        np.greater: (A, B),
        np.greater_equal: (A, -B),
        np.equal: (A, -B),
        np.not_equal: (A, -B),
        np.logical_and: (np.array([1.0, 0.0, 2.0]), np.array([3.0, 1.0, 0.0])),
        np.logical_or: (np.array([1.0, 0.0, 0.0]), np.array([3.0, 1.0, 0.0])),
    }
    cases: list[Case] = []
    for ufunc, x in one.items():
        cases += [
            (f"np.{ufunc.__name__} of a vector", ufunc, (x,)),
            (f"np.{ufunc.__name__} of a matrix", ufunc, (np.stack([x, x[::-1]]),)),
            (f"np.{ufunc.__name__} of a number", ufunc, (x[0],)),
        ]
    for ufunc, (x, y) in two.items():
        cases += [
            (f"np.{ufunc.__name__} of vectors", ufunc, (x, y)),
            (f"np.{ufunc.__name__} of a traced and a plain vector", lambda a, f=ufunc, b=y: f(a, b), (x,)),
            (f"np.{ufunc.__name__} of a plain and a traced vector", lambda b, f=ufunc, a=x: f(a, b), (y,)),
            (f"np.{ufunc.__name__} of a number and a vector", ufunc, (x[0], y)),
            (f"np.{ufunc.__name__} of numbers", ufunc, (x[0], y[0])),
            (f"np.{ufunc.__name__} of a column and a row", ufunc, (x[:, np.newaxis], y[np.newaxis])),
            (f"np.{ufunc.__name__}.outer", ufunc.outer, (x, y)),
        ]
    for ufunc in (np.add, np.multiply, np.minimum, np.maximum):
        cases += [
            (f"np.{ufunc.__name__}.reduce", lambda x, f=ufunc: f.reduce(x), (N,)),
            (f"np.{ufunc.__name__}.reduce over all", lambda x, f=ufunc: f.reduce(x, axis=None), (N,)),
            (f"np.{ufunc.__name__}.reduce over rows", lambda x, f=ufunc: f.reduce(x, axis=1, keepdims=True), (N,)),
            (f"np.{ufunc.__name__}.reduce from 0.5", lambda x, f=ufunc: f.reduce(x, axis=1, initial=0.5), (N,)),
            (f"np.{ufunc.__name__}.accumulate", lambda x, f=ufunc: f.accumulate(x, axis=1), (N,)),
        ]
    return cases


CASES_OF_FUNCTIONS: list[Case] = [
    ("np.append", lambda a, b: np.append(a, b), (A, B)),
    ("np.atleast_1d", lambda s: np.atleast_1d(s), (S,)),
    ("np.atleast_2d", lambda a: np.atleast_2d(a), (A,)),
    ("np.block", lambda m: np.block([[m, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]), (M,)),
    ("np.broadcast_to", lambda a: np.broadcast_to(a, (2, 3)), (A,)),
    ("np.column_stack", lambda a, b: np.column_stack([a, b]), (A, B)),
    ("np.concatenate", lambda a: np.concatenate([a, np.ones(2)]), (A,)),
    ("np.concatenate along columns", lambda n: np.concatenate([n, 2.0 * n], axis=1), (N,)),
    ("np.concatenate of numbers", lambda a: np.concatenate([[a[0], 1.0], a]), (A,)),
    ("np.copy", lambda a: np.copy(a), (A,)),
    ("np.cumsum", lambda n: np.cumsum(n), (N,)),
    ("np.cumsum along rows", lambda n: np.cumsum(n, axis=1), (N,)),
    ("np.diag of a vector", lambda a: np.diag(a), (A,)),
    ("np.diag of a matrix", lambda m: np.diag(m), (M,)),
    ("np.diagonal", lambda m: np.diagonal(m), (M,)),
    ("np.diff", lambda a: np.diff(a), (A,)),
    ("np.dot of vectors", lambda a, b: np.dot(a, b), (A, B)),
    ("np.dot of a plain matrix", lambda a: np.dot(M, a), (A,)),
    ("np.einsum", lambda m, a: np.einsum("ij,j->i", m, a), (M, A)),
    ("np.einsum of three", lambda m, a: np.einsum("ij,jk,k->i", m, m, a), (M, A)),
    ("np.einsum trace", lambda m: np.einsum("ii", m), (M,)),
    ("np.empty_like", lambda a: np.empty_like(a) * 0.0 + a, (A,)),
    ("np.expand_dims", lambda a: np.expand_dims(a, 1), (A,)),
    ("np.flip", lambda a: np.flip(a), (A,)),
    ("np.full_like", lambda a: np.full_like(a, 2.5), (A,)),
    ("np.full_like with a traced number", lambda a: np.full_like(a, a[0]), (A,)),
    ("np.hstack", lambda a, b: np.hstack([a, b]), (A, B)),
    ("np.inner", lambda a, b: np.inner(a, b), (A, B)),
    ("np.moveaxis", lambda n: np.moveaxis(n, 0, 1), (N,)),
    ("np.ndim", lambda n: np.ndim(n), (N,)),
    ("np.outer", lambda a, b: np.outer(a, b), (A, B)),
    ("np.prod", lambda n: np.prod(n), (N,)),
    ("np.prod along columns", lambda n: np.prod(n, axis=0), (N,)),
    ("np.ravel", lambda n: np.ravel(n), (N,)),
    ("np.repeat", lambda a: np.repeat(a, 2), (A,)),
    ("np.reshape", lambda n: np.reshape(n, (3, 2)), (N,)),
    ("np.roll", lambda a: np.roll(a, 1), (A,)),
    ("np.shape", lambda n: np.shape(n), (N,)),
    ("np.size", lambda n: np.size(n), (N,)),
    ("np.split", lambda a: np.split(a, 3)[2], (A,)),
    ("np.squeeze", lambda n: np.squeeze(n[:1]), (N,)),
    ("np.stack", lambda a, b: np.stack([a, b]), (A, B)),
    ("np.stack of numbers", lambda a: np.stack([a[0], a[2]]), (A,)),
    ("np.sum", lambda n: np.sum(n), (N,)),
    ("np.sum along rows", lambda n: np.sum(n, axis=1, keepdims=True), (N,)),
    ("np.sum over two axes", lambda n: np.sum(n, axis=(0, 1)), (N,)),
    ("np.sum of a number", lambda s: np.sum(s), (S,)),
    ("np.sum of conditions counts", lambda a: np.sum(a > 0.0), (A,)),
    ("np.swapaxes", lambda n: np.swapaxes(n, 0, 1), (N,)),
    ("np.take", lambda a: np.take(a, [2, 0]), (A,)),
    ("np.tile", lambda a: np.tile(a, 2), (A,)),
    ("np.trace", lambda m: np.trace(m), (M,)),
    ("np.transpose", lambda n: np.transpose(n), (N,)),
    ("np.vstack", lambda a, b: np.vstack([a, b]), (A, B)),
    ("np.where", lambda a, b: np.where(a > b, a, 0.5), (A, B)),
    ("np.where of numbers", lambda s: np.where(s > 0.5, s, -s), (S,)),
    ("np.where of a plain condition", lambda a: np.where([True, False, True], a, 0.0), (A,)),
    ("np.where broadcast", lambda n, a: np.where(n > 0.0, n, a), (N, A)),
    ("np.clip", lambda a: np.clip(a, -0.5, 0.5), (A,)),
    ("np.clip by vectors", lambda a, b: np.clip(a, -np.abs(b), np.abs(b)), (A, B)),
    ("np.clip from below", lambda a: np.clip(a, 0.0, None), (A,)),
    ("np.clip from above", lambda a: np.clip(a, None, 0.0), (A,)),
    ("np.clip by keywords", lambda a: np.clip(a, min=-0.2, max=0.2), (A,)),
    ("np.clip of a number", lambda s: np.clip(s, 0.0, 0.5), (S,)),
    ("np.linalg.norm", lambda a: np.linalg.norm(a), (A,)),
    ("np.linalg.norm, ord=2", lambda a: np.linalg.norm(a, 2), (A,)),
    ("np.linalg.norm of a matrix", lambda m: np.linalg.norm(m), (M,)),
    ("np.linalg.norm, Frobenius", lambda m: np.linalg.norm(m, "fro"), (M,)),
    ("np.linalg.norm of rows", lambda n: np.linalg.norm(n, axis=1), (N,)),
    ("np.linalg.norm of rows, kept", lambda n: np.linalg.norm(n, axis=1, keepdims=True), (N,)),
    ("np.linalg.norm of rows, ord=2", lambda n: np.linalg.norm(n, ord=2, axis=1), (N,)),
    ("np.linalg.solve", lambda m, a: np.linalg.solve(m, a), (M, A)),
    ("np.linalg.solve of columns", lambda m, n: np.linalg.solve(m, n.T), (M, N)),
    ("np.linalg.solve by a plain matrix", lambda a: np.linalg.solve(M, a), (A,)),
    ("np.linalg.inv", lambda m: np.linalg.inv(m), (M,)),
    ("np.cross", lambda a, b: np.cross(a, b), (A, B)),
    ("np.cross with a plain vector", lambda a: np.cross(B, a), (A,)),
    ("np.mean", lambda n: np.mean(n), (N,)),
    ("np.mean along rows", lambda n: np.mean(n, axis=1), (N,)),
    ("np.mean along columns, kept", lambda n: np.mean(n, axis=0, keepdims=True), (N,)),
    ("np.mean of conditions", lambda a: np.mean(a > 0.0), (A,)),
    ("np.max", lambda n: np.max(n), (N,)),
    ("np.max along rows, kept", lambda n: n - np.max(n, axis=1, keepdims=True), (N,)),
    ("np.min along columns", lambda n: np.min(n, axis=0), (N,)),
    ("np.any", lambda n: np.any(n > 1.0), (N,)),
    ("np.any along rows", lambda n: np.any(n > 2.0, axis=1), (N,)),
    ("np.any of numbers", lambda a: ~np.any(a), (A,)),
    ("np.all", lambda n: np.all(n > -2.0), (N,)),
    ("np.all along columns, kept", lambda n: np.all(n > 0.0, axis=0, keepdims=True), (N,)),
    ("np.zeros_like", lambda a: np.zeros_like(a) + a, (A,)),
    ("np.zeros_like of floats", lambda a: np.zeros_like(a, dtype=float) + a, (A,)),
    ("np.ones_like", lambda n: np.ones_like(n) * n, (N,)),
    ("np.array2string", lambda a: len(np.array2string(a)) > 0, (A,)),
]

CASES_OF_METHODS: list[Case] = [
    ("a.sum()", lambda n: n.sum(), (N,)),
    ("a.sum(axis)", lambda n: n.sum(axis=0), (N,)),
    ("a.mean()", lambda n: n.mean(), (N,)),
    ("a.mean(axis)", lambda n: n.mean(axis=1), (N,)),
    ("a.max()", lambda n: n.max(), (N,)),
    ("a.min(axis)", lambda n: n.min(axis=1), (N,)),
    ("a.prod()", lambda n: n.prod(), (N,)),
    ("a.cumsum()", lambda a: a.cumsum(), (A,)),
    ("a.any()", lambda a: (a > 0.0).any(), (A,)),
    ("a.all(axis)", lambda n: (n > 0.0).all(axis=0), (N,)),
    ("a.clip()", lambda a: a.clip(-0.5, 0.5), (A,)),
    ("a.clip(None)", lambda a: a.clip(None, 0.5), (A,)),
    ("a.dot()", lambda m, a: m.dot(a), (M, A)),
    ("a.trace()", lambda m: m.trace(), (M,)),
    ("a.diagonal()", lambda m: m.diagonal(), (M,)),
    ("a.std()", lambda a: a.std(), (A,)),
    ("a.var()", lambda a: a.var(), (A,)),
    ("a.T", lambda n: n.T, (N,)),
    ("a.reshape()", lambda n: n.reshape(6), (N,)),
    ("a.ravel()", lambda n: n.ravel(), (N,)),
    ("a.flatten()", lambda n: n.flatten(), (N,)),
    ("a.copy()", lambda n: n.copy(), (N,)),
    ("a.tolist()", lambda n: n.tolist(), (N,)),
    ("a.item()", lambda n: n.item(2), (N,)),
    ("a.repeat()", lambda a: a.repeat(2), (A,)),
    ("a.take()", lambda a: a.take([0, 2]), (A,)),
    ("a[list]", lambda a: a[[2, 0]], (A,)),
    ("a[mask]", lambda a: a[np.array([True, False, True])], (A,)),
    ("a[...]", lambda a: a[...], (A,)),
    ("a[0, ...]", lambda n: n[0, ...], (N,)),
    ("len", lambda n: len(n), (N,)),
    ("sum", lambda a: sum(a), (A,)),
    ("sum of conditions counts", lambda a: sum(a > 0.0), (A,)),
    ("unpacking", lambda a: [a[0], *a], (A,)),
    ("a copy of the module", lambda a: copy.deepcopy(a), (A,)),
]

CASES_OF_OPERATORS: list[Case] = [
    ("a + b", operator.add, (A, B)),
    ("a - 1", lambda a: a - 1, (A,)),
    ("1 - a", lambda a: 1 - a, (A,)),
    ("2 / a", lambda a: 2 / a, (A,)),
    ("a // b", lambda a, b: a // b, (3.0 * A, B)),
    ("7 // s", lambda s: 7 // s, (S,)),
    ("s // 0.25", lambda s: s // 0.25, (S,)),
    ("s // t", lambda s, t: s // t, (S, -0.25)),
    ("s % 0.25", lambda s: s % 0.25, (S,)),
    ("-s % 0.25", lambda s: -s % 0.25, (S,)),
    ("7 % s", lambda s: 7 % s, (S,)),
    ("a % 0.5", lambda a: a % 0.5, (A,)),
    ("a ** 2", lambda a: a**2, (A,)),
    ("a ** 3", lambda a: a**3, (A,)),
    ("a ** -2", lambda a: a**-2, (A,)),
    ("a ** 0", lambda a: a**0, (A,)),
    ("a ** 0.5", lambda a: np.abs(a) ** 0.5, (A,)),
    ("a ** 2.5", lambda a: np.abs(a) ** 2.5, (A,)),
    ("a ** 0.3", lambda a: np.abs(a) ** 0.3, (A,)),
    ("a ** 21, below zero", lambda a: a**21, (A,)),
    ("a ** 40, below zero", lambda a: a**40, (A,)),
    ("2 ** a", lambda a: 2.0**a, (A,)),
    ("s ** t", lambda s, t: s**t, (S, -1.5)),
    ("a ** traced whole numbers, below zero", lambda a, b: a**b, (A, np.array([3.0, 2.0, -1.0]))),
    ("a ** traced odd numbers, below zero", lambda a, b: a**b, (-np.abs(A), np.array([3.0, -3.0, 1.0]))),
    ("a ** traced zero", lambda a, b: a**b, (np.array([0.0, -2.0, 3.0]), np.zeros(3))),
    ("zero ** traced", lambda a, b: a**b, (np.zeros(3), np.array([0.5, 2.0, 1.0]))),
    ("abs", lambda a: abs(a), (A,)),
    ("-a", operator.neg, (A,)),
    ("+a", operator.pos, (A,)),
    ("m @ a", operator.matmul, (M, A)),
    ("a @ m", operator.matmul, (A, M)),
    ("a @ b", operator.matmul, (A, B)),
    ("n @ m", operator.matmul, (N, M)),
    ("plain @ a", lambda a: M @ a, (A,)),
    ("a @ plain", lambda a: a @ M, (A,)),
    ("m @ m @ a", lambda m, a: m @ m @ a, (M, A)),
    ("np.float64 * s", lambda s: np.float64(2.5) * s, (S,)),
    ("s * np.float64", lambda s: s * np.float64(2.5), (S,)),
    ("np.float64 - s", lambda s: np.float64(2.5) - s, (S,)),
    ("np.float64 / s", lambda s: np.float64(2.5) / s, (S,)),
    ("np.float64 ** s", lambda s: np.float64(2.5) ** s, (S,)),
    ("np.float64 % s", lambda s: np.float64(2.5) % s, (S,)),
    ("np.float64 < s", lambda s: np.float64(0.5) < s, (S,)),
    ("np.float32 * s", lambda s: np.float32(2.5) * s, (S,)),
    ("np.int64 + s", lambda s: np.int64(2) + s, (S,)),
    ("True + s", lambda s: True + s, (S,)),
    ("np.bool_ * s", lambda s: np.bool_(True) * s, (S,)),
    ("s + plain array", lambda s: s + A, (S,)),
    ("plain array * s", lambda s: A * s, (S,)),
    ("plain list + a", lambda a: [1.0, 2.0, 3.0] + a, (A,)),  # noqa: RUF005
    ("a < b", operator.lt, (A, B)),
    ("a <= 0.3", lambda a: a <= 0.3, (A,)),
    ("0.3 >= a", lambda a: 0.3 >= a, (A,)),  # noqa: SIM300
    ("a == b", lambda a, b: a == -b, (A, B)),
    ("a != b", lambda a, b: a != -b, (A, B)),
    ("s == 0.6", lambda s: s == 0.6, (S,)),
    ("s != 0.6", lambda s: s != 0.6, (S,)),
    ("a & b", lambda a, b: (a > 0.0) & (b > 0.0), (A, B)),
    ("a | b", lambda a, b: (a > 0.0) | (b > 0.0), (A, B)),
    ("a ^ b", lambda a, b: (a > 0.0) ^ (b > 0.0), (A, B)),
    ("~a", lambda a: ~(a > 0.0), (A,)),
    ("c & True", lambda s: (s > 0.0) & True, (S,)),
    ("np.bool_ | c", lambda s: np.bool_(False) | (s > 0.0), (S,)),
    ("c ^ True", lambda s: (s > 0.0) ^ True, (S,)),
    ("c == True", lambda s: (s > 0.0) == True, (S,)),  # noqa: E712
    ("c == False", lambda s: (s > 0.0) == False, (S,)),  # noqa: E712
    ("c != True", lambda s: (s > 0.0) != True, (S,)),  # noqa: E712
    ("c == d", lambda s, t: (s > 0.0) == (t > 0.0), (S, -1.0)),
    ("c == 1.0", lambda s: (s > 0.0) == 1.0, (S,)),
    ("conditions of arrays are equal", lambda a, b: (a > 0.0) == (b > 0.0), (A, B)),
    ("~ of a condition that is known", lambda s: ~(tm.maximum(s, math.inf) == math.inf), (S,)),
    ("~ of conditions that are known", lambda a: ~(0.0 * a == 0.0), (A,)),
    ("c * s", lambda s: (s > 0.0) * s, (S,)),
    ("s + c", lambda s: s + (s > 0.0), (S,)),
    ("1.0 - c", lambda s: 1.0 - (s > 0.0), (S,)),
    ("c - 1", lambda s: (s > 0.0) - 1.0, (S,)),
    ("c * d", lambda s, t: (s > 0.0) * (t > 0.0) * 1.0, (S, -1.0)),
    ("conditions * array", lambda a: (a > 0.0) * a, (A,)),
    ("conditions @ array", lambda a: (a > 0.0) @ a, (A,)),
]


def changed(start: Callable[[Any], Any], change: Callable[[Any, Any], None]) -> Callable[[Any], Any]:
    """A function that changes an array in place and returns it."""

    def run(a: Any) -> Any:
        out = start(a)
        change(out, a)
        return out

    return run


def _set(index: Any, value: Callable[[Any], Any]) -> Callable[[Any, Any], None]:
    def change(out: Any, a: Any) -> None:
        out[index] = value(a)

    return change


CASES_IN_PLACE: list[Case] = [
    ("zeros, then one entry", changed(lambda a: tm.zeros(3), _set(0, lambda a: a[1])), (A,)),
    ("zeros, then a slice", changed(lambda a: tm.zeros(4), _set(slice(1, 4), lambda a: a)), (A,)),
    ("zeros, then a row", changed(lambda a: tm.zeros((2, 3)), _set(1, lambda a: a)), (A,)),
    ("ones, then a column", changed(lambda a: tm.ones((3, 2)), _set((slice(None), 0), lambda a: a)), (A,)),
    ("eye, then an entry", changed(lambda a: tm.eye(3), _set((0, 2), lambda a: a[0])), (A,)),
    ("full, then a mask", changed(lambda a: tm.full(3, 0.5), _set([True, False, True], lambda a: a[:2])), (A,)),
    ("zeros += a", changed(lambda a: tm.zeros(3), lambda out, a: operator.iadd(out, a)), (A,)),
    ("zeros -= 1", changed(lambda a: tm.zeros(3), lambda out, a: operator.isub(out, 1.0)), (A,)),
    ("copy *= b", changed(lambda a: a.copy(), lambda out, a: operator.imul(out, B)), (A,)),
    ("copy /= 2", changed(lambda a: a.copy(), lambda out, a: operator.itruediv(out, 2.0)), (A,)),
    ("copy **= 2", changed(lambda a: a.copy(), lambda out, a: operator.ipow(out, 2)), (A,)),
    ("copy[0] += 1", changed(lambda a: a.copy(), lambda out, a: out.__setitem__(0, out[0] + 1.0)), (A,)),
    ("out=", changed(lambda a: tm.zeros(3), lambda out, a: np.add(a, 1.0, out=out)), (A,)),
    ("sin with out=", changed(lambda a: tm.zeros(3), lambda out, a: np.sin(a, out=out)), (A,)),
    ("a slice of zeros += a", changed(lambda a: tm.zeros(4), lambda out, a: operator.iadd(out[1:], a)), (A,)),
    ("fill", changed(lambda a: tm.zeros(3), lambda out, a: out.fill(a[0])), (A,)),
]

CASES_OF_PLAIN_OBJECT_ARRAYS: list[Case] = [
    ("np.array([x, y])", lambda a: np.array([a[0], a[1]]), (A,)),
    ("np.array([x, 0.0]) * 2", lambda a: np.array([a[0], 0.0]) * 2.0, (A,)),
    ("np.array([[x, 0], [0, y]]) @ b", lambda a: np.array([[a[0], 0.0], [0.0, a[1]]]) @ a[:2], (A,)),
    ("np.sin(np.array([x, y]))", lambda a: np.sin(np.array([a[0], a[1]])), (A,)),
    ("np.sqrt([x, y])", lambda a: np.sqrt([a[0] ** 2, a[1] ** 2]), (A,)),
    ("np.concatenate of lists", lambda a: np.concatenate([[a[0]], [1.0, a[1]]]), (A,)),
    ("np.sum of a list", lambda a: np.sum([a[0], 1.0, a[2]]), (A,)),
    ("np.linalg.norm of a list", lambda a: np.linalg.norm([a[0], a[1]]), (A,)),
    ("np.floor of an array", lambda a: np.floor(np.array([a[0], a[1]])), (3.0 * A,)),
    ("np.ceil of an array", lambda a: np.ceil(np.array([a[0], a[1]])), (3.0 * A,)),
    ("np.asarray", lambda a: np.asarray(a) + 1.0, (A,)),
    ("math.floor", lambda s: math.floor(s), (2.0 * S,)),
    ("math.ceil", lambda s: math.ceil(s), (2.0 * S,)),
]

ALL_CASES = [
    *cases_of_ufuncs(),
    *CASES_OF_FUNCTIONS,
    *CASES_OF_METHODS,
    *CASES_OF_OPERATORS,
    *CASES_IN_PLACE,
    *CASES_OF_PLAIN_OBJECT_ARRAYS,
]


@pytest.mark.parametrize(("what", "function", "arguments"), ALL_CASES, ids=[case[0] for case in ALL_CASES])
def test_it_gives_what_numpy_gives(what: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    plain = [np.float64(x) if np.ndim(x) == 0 else x.copy() for x in arguments]
    expected = np.asarray(function(*plain), dtype=np.float64)
    got = traced_value(function, *arguments)
    assert got.shape == expected.shape
    np.testing.assert_allclose(got, expected, rtol=4.0 * ROUNDING, atol=4.0 * ROUNDING)


# -------------------------------------------------------------------- all of NumPy

OTHER_WORDS = {  # files, settings, tests, and functions that give no numbers
    "broadcast errstate frombuffer fromfile fromiter fromregex fromstring from_dlpack genfromtxt get_include getbufsize",
    "geterr info iterable load loadtxt memmap mintypecode min_scalar_type ndenumerate ndindex nditer open_memmap",
    "printoptions save savetxt savez savez_compressed set_printoptions setbufsize seterr seterrcall show_config",
    "show_runtime test typename vectorize",
}
EXCLUDED = {name for line in OTHER_WORDS for name in line.split()}
NOT_ABOUT_VALUES = {"np.empty_like", "np.array2string", "np.array_repr", "np.array_str"}
PATTERNS = [(A,), (A, B), (M,), (M, A), (M, M), (A, 1.0), (A, 0.5), (B, B, B)]


def functions_of_numpy() -> list[str]:
    return [
        f"{module}.{name}"
        for module, space in (("np", np), ("np.linalg", np.linalg))
        for name in sorted(dir(space))
        if not name.startswith("_") and name not in EXCLUDED
        if callable(getattr(space, name)) and not isinstance(getattr(space, name), type)
    ]


@pytest.mark.filterwarnings("ignore")  # of NumPy, about what is given here
@pytest.mark.parametrize("name", functions_of_numpy())
def test_no_function_of_numpy_gives_a_wrong_number_or_a_text_that_is_not_ours(name: str) -> None:
    function = operator.attrgetter(name.removeprefix("np."))(np)
    for arguments in PATTERNS:
        try:
            expected = np.asarray(function(*(np.copy(x) for x in arguments)), dtype=np.float64)
        except Exception:
            continue
        try:
            got = traced_value(function, *arguments)
        except TautError as error:
            assert len(str(error)) > 40  # noqa: PT017 - a sentence
            continue
        if name not in NOT_ABOUT_VALUES:
            np.testing.assert_allclose(got, expected, rtol=10.0 * ROUNDING, atol=10.0 * ROUNDING)


# -------------------------------------------------------------------- what is refused, and in which words


def frozen(a: Any) -> Any:
    view = a.view()
    view.flags.writeable = False
    return view


REFUSED: list[tuple[str, Callable[..., Any]]] = [
    ("float(x)", lambda a: float(a[0])),
    ("complex(x)", lambda a: complex(a[0])),
    ("math.sin(x)", lambda a: math.sin(a[0])),
    ("'%f' % x", lambda a: "%f" % a[0]),  # noqa: UP031
    ("np.float64(x)", lambda a: np.float64(a[0])),
    ("a.astype(float)", lambda a: a.astype(float)),
    ("np.asarray(a, float)", lambda a: np.asarray(a, dtype=float)),
    ("np.array([x, 0.0], dtype=float)", lambda a: np.array([a[0], 0.0], dtype=float)),
    ("floats[0] = x", lambda a: np.zeros(3).__setitem__(0, a[0])),
    ("floats[:] = a", lambda a: np.zeros(3).__setitem__(slice(None), a)),
    ("floats.fill(x)", lambda a: np.zeros(3).fill(a[0])),
    ("floats.put", lambda a: np.zeros(3).put(0, a[0])),
    ("int(x)", lambda a: int(a[0])),
    ("math.trunc(x)", lambda a: math.trunc(a[0])),
    ("range(x)", lambda a: range(a[0])),
    ("a[x]", lambda a: [1.0, 2.0][a[0]]),
    ("if x", lambda a: 1.0 if a[0] else 2.0),
    ("if x > 0", lambda a: 1.0 if a[0] > 0.0 else 2.0),
    ("not x", lambda a: not a[0]),
    ("x and y", lambda a: a[0] and a[1]),
    ("0 < x < 1", lambda a: 0.0 < a[0] < 1.0),
    ("min(a)", lambda a: min(a)),
    ("max(x, 0)", lambda a: max(a[0], 0.0)),
    ("sorted(a)", lambda a: sorted(a)),
    ("x in list", lambda a: a[0] in [a[1], a[2]]),
    ("a.argmax()", lambda a: a.argmax()),
    ("a.sort()", lambda a: a.copy().sort()),
    ("a.nonzero()", lambda a: a.nonzero()),
    ("any(a > 0)", lambda a: any(a > 0.0)),
    ("np.clip of a list", lambda a: np.clip([a[0], a[1]], 0.0, 1.0)),
    ("np.maximum of a list", lambda a: np.maximum([a[0], 1.0], 0.0)),
    ("np.where of a list", lambda a: np.where([a[0] > 0.0], 1.0, 0.0)),
    ("floats += a", lambda a: operator.iadd(np.zeros(3), a)),
    ("floats *= x", lambda a: operator.imul(np.ones(3), a[0])),
    ("np.sin(a, out=floats)", lambda a: np.sin(a, out=np.zeros(3))),
    ("np.add(floats, x, out=floats)", lambda a: np.add(np.zeros(3), a[0], out=np.zeros(3))),
    ("given += 1", lambda a: operator.iadd(frozen(a), 1.0)),
    ("np.sin(a, out=given)", lambda a: np.sin(a, out=frozen(a))),
    ("c + d", lambda a: (a[0] > 0.0) + (a[1] > 0.0)),
    ("c - d", lambda a: (a[0] > 0.0) - (a[1] > 0.0)),
    ("c + True", lambda a: (a[0] > 0.0) + True),
    ("conditions + conditions", lambda a: (a > 0.0) + (a < 1.0)),
    ("round(x)", lambda a: round(a[0], 2)),
    ("np.round", lambda a: np.round(a)),
    ("a.round()", lambda a: a.round()),
    ("np.linalg.svd", lambda a: np.linalg.svd(np.outer(a, a))),
    ("np.linalg.eigh", lambda a: np.linalg.eigh(np.outer(a, a))),
    ("np.linalg.det", lambda a: np.linalg.det(np.outer(a, a))),
    ("np.linalg.pinv", lambda a: np.linalg.pinv(np.outer(a, a))),
    ("np.sort", lambda a: np.sort(a)),
    ("np.argmax", lambda a: np.argmax(a)),
    ("np.interp", lambda a: np.interp(a[0], [0.0, 1.0], [0.0, 1.0])),
    ("np.isnan", lambda a: np.isnan(a)),
    ("np.allclose", lambda a: np.allclose(a, 1.0)),
    ("np.sinh", lambda a: np.sinh(a)),
    ("np.modf", lambda a: np.modf(a)),
    ("np.add.at", lambda a: np.add.at(a.copy(), [0], 1.0)),
    ("np.add.reduceat", lambda a: np.add.reduceat(a, [0, 1])),
    ("where=", lambda a: np.add(a, 1.0, where=[True, False, True], out=tm.zeros(3))),
    ("sin where=", lambda a: np.sin(a, where=a > 0.0, out=tm.zeros(3))),
    ("dtype=int", lambda a: np.add(a, 1.0, dtype=np.int64)),
    ("np.sum where=", lambda a: np.sum(a, where=[True, False, True])),
    ("np.max initial=", lambda a: np.max(a, initial=0.0)),
    ("np.clip out=", lambda a: np.clip(a, 0.0, 1.0, out=tm.zeros(3))),
    ("np.where(c)", lambda a: np.where(a > 0.0)),
    ("np.zeros_like(int)", lambda a: np.zeros_like(a, dtype=int)),
    ("np.zeros_like(shape)", lambda a: np.zeros_like(a, shape=2)),
    ("norm, ord=1", lambda a: np.linalg.norm(a, 1)),
    ("spectral norm", lambda a: np.linalg.norm(np.outer(a, a), 2)),
    ("np.cross of rows", lambda a: np.cross(np.outer(a, a), a)),
    ("np.cross, axis", lambda a: np.cross(a, a, axis=0)),
    ("nan", lambda a: a * np.array([1.0, np.nan, 1.0])),
    ("1 / 0", lambda a: a / 0.0),
    ("log of a known 0", lambda a: np.log(0.0 * a)),
    ("root of -1", lambda a: np.sqrt(0.0 * a - 1.0)),
    ("power of -8", lambda a: np.power(0.0 * a - 8.0, 0.3)),
    ("(-2) ** x", lambda a: (-2.0) ** a[0]),
    ("0 ** a", lambda a: 0.0**a),
    ("None in where", lambda a: tm.where(a > 0.0, a, None)),
    ("text in where", lambda a: tm.where(a > 0.0, a, "1.0")),
    ("complex in where", lambda a: tm.where(a > 0.0, a, 1j)),
    ("ragged rows", lambda a: tm.array([a, 0.0])),
    ("ragged lists", lambda a: tm.array([[a[0], 1.0], [2.0]])),
    ("cross of two", lambda a: tm.cross(a[:2], a[:2])),
    ("cross of rows", lambda a: tm.cross(np.outer(a, a), a)),
    ("skew of four", lambda a: tm.skew([*a, 1.0])),
    ("pickle", lambda a: pickle.dumps(a)),
]


@pytest.mark.parametrize(("what", "function"), REFUSED, ids=[case[0] for case in REFUSED])
def test_it_is_refused_in_words_that_name_the_line(what: str, function: Callable[..., Any]) -> None:
    with refused((TraceError, ShapeError)):
        traced_value(function, A)


def test_print_and_format_show_that_a_value_is_traced() -> None:
    shown = []
    traced_value(lambda a: shown.append(f"{a[0]:.3f} {a[0] > 0.0} {a[:2]!r}") or a, A)
    assert shown == [
        "<traced value 0> <traced condition 4> Traced([<traced value 0>, <traced value 1>], dtype=object)"
    ]


def test_a_copy_of_a_symbol_is_the_symbol() -> None:
    graph = Graph()
    x = Scalar(graph, graph.input())
    assert copy.copy(x) is x
    assert copy.deepcopy([x])[0] is x


def test_an_array_of_what_is_given_is_a_copy() -> None:
    a = traced_array([1.0, 2.0])
    graph = Graph()
    a[0] = Scalar(graph, graph.input())
    out = tm.array(a)
    out[1] = 5.0
    assert a[1] == 2.0


def test_symbols_hash_and_compare_as_themselves() -> None:
    graph = Graph()
    x, y = Scalar(graph, graph.input()), Scalar(graph, graph.input())
    assert len({x, y, x}) == 2
    assert isinstance(x == y, Condition)
    assert (x == "text") is False
    assert (x != None) is True  # noqa: E711


def test_arrays_of_floats_stay_floats_outside_a_trace() -> None:
    for made in (tm.zeros(2), tm.ones((2, 2)), tm.full(2, 3.0), tm.eye(2), tm.arange(3), tm.array([1, 2])):
        assert made.dtype == np.float64
        assert not isinstance(made, Traced)
    with tracing(Graph()):
        assert isinstance(tm.zeros(2), Traced)
    assert not isinstance(tm.zeros(2), Traced)


@pytest.mark.parametrize(
    "compare", [lambda a, b: (a > 0.0) == b, lambda a, b: (a > 0.0) != b, lambda a, b: np.equal(a > 0.0, b)]
)
def test_a_condition_compares_with_a_number_as_in_numpy(compare: Callable[..., Any]) -> None:
    a, b = np.array([1.0, -1.0, 2.0, -2.0]), np.array([1.0, 0.0, 0.0, 1.0])
    for value in (b, 1.0, 0.0):
        expected = np.where(compare(a, value), 1.0, -1.0)
        got = traced_value(lambda a, b: tm.where(compare(a, b), 1.0, -1.0), a, np.asarray(value))
        np.testing.assert_array_equal(got, expected)


def test_one_to_a_traced_power_is_one() -> None:
    np.testing.assert_array_equal(traced_value(lambda x: 1.0**x, np.asarray(0.7)), 1.0)
