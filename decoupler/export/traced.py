"""Arrays that remember what they were computed by: NumPy calls `Traced` in their place, which computes and records.

A network that is written for NumPy is exported as it stands. What it does to constants alone is done while it is
recorded. The first dimension is that of scans, whose number stays free, so that no operation may mix them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from math import prod
from operator import add, itemgetter, methodcaller
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from common.errors import TriPillarError

#: operations on elements by NumPy's name: ONNX's operator, and C's expression
ELEMENTWISE = {
    "add": ("Add", "{} + {}"),
    "subtract": ("Sub", "{} - {}"),
    "multiply": ("Mul", "{} * {}"),
    "divide": ("Div", "{} / {}"),
    "negative": ("Neg", "-({})"),
    "absolute": ("Abs", "TRIPILLAR_MATH(fabs)({})"),
    "sqrt": ("Sqrt", "TRIPILLAR_MATH(sqrt)({})"),
    "exp": ("Exp", "TRIPILLAR_MATH(exp)({})"),
    "log": ("Log", "TRIPILLAR_MATH(log)({})"),
    "tanh": ("Tanh", "TRIPILLAR_MATH(tanh)({})"),
    "power": ("Pow", "TRIPILLAR_MATH(pow)({}, {})"),
    "maximum": ("Max", "tripillar_max({}, {})"),
    "minimum": ("Min", "-tripillar_max(-({}), -({}))"),
    "less": ("Less", "{} < {}"),
    "less_equal": ("LessOrEqual", "{} <= {}"),
    "greater": ("Greater", "{} > {}"),
    "greater_equal": ("GreaterOrEqual", "{} >= {}"),
    "bitwise_and": ("And", "{} && {}"),
    "bitwise_or": ("Or", "{} || {}"),
    "invert": ("Not", "!{}"),
    "where": ("Where", "{} ? {} : {}"),
}
#: functions of NumPy, and methods of arrays, that only move elements
MOVES = ["concatenate", "stack", "repeat", "take", "reshape", "ravel", "squeeze", "expand_dims"]
MOVES += ["flip", "moveaxis", "roll", "swapaxes", "transpose"]


class ExportError(TriPillarError, RuntimeError, AttributeError):
    """A model that cannot be exported, for one because its arrays then lack a method."""


@dataclass(frozen=True, eq=False)
class Traced(NDArrayOperatorsMixin):
    """What an operation gave of some scans: one of `ELEMENTWISE`, or input, constant, matmul, sum, concat or moved."""

    values: NDArray[Any]  #: (n, ...); of a constant (1, ...), for each scan
    real: Any  #: type of the numbers in which all is computed; constants are kept in double
    operation: str = "input"
    inputs: "tuple[Traced, ...]" = ()  #: those of concat are laid flat
    detail: Any = None  #: axis of sum; of moved the places (...) of its elements in its input's scan laid flat

    __hash__ = object.__hash__  # one is only itself; == compares elements

    def __array_ufunc__(self, ufunc: Any, method: str, *given: Any, **options: Any) -> Any:
        refuse(
            method != "__call__" or options.keys() - {"out"}, f"{ufunc.__name__}.{method}"
        )  # += and the like give out
        return _product(*given) if ufunc is np.matmul else _applied(ufunc, *given)

    def __array_function__(self, function: Any, _: Any, given: tuple[Any, ...], options: dict[str, Any]) -> Any:
        name, (first, *others) = function.__name__, given
        if name in MOVES and isinstance(first, Sequence):
            return _moved(lambda *parts: function(parts, *others, **options), *first)
        if name in MOVES:
            return _moved(lambda part: function(part, *others, **options), first)
        if name == "sum":
            return first.sum(*others, **options)
        if name in ("ones_like", "zeros_like"):
            return function(first.values)
        return _applied(function, *given)

    def __getattr__(self, name: str) -> Any:
        refuse(name not in MOVES, name)
        return lambda *given, **options: _moved(methodcaller(name, *given, **options), self)

    def __getitem__(self, key: Any) -> Any:
        return _moved(itemgetter(key), self)

    def __len__(self) -> int:
        return len(self.values)

    def __bool__(self) -> bool:
        refuse(True, "a decision by what is read")
        return False

    def any(self) -> bool:
        """Of some scan it is true."""
        return True

    def clip(self, low: Any) -> Any:
        """The larger of its elements and these."""
        return np.maximum(self, low)

    def sum(self, axis: int) -> "Traced":
        """Sum along one axis that is not that of scans."""
        axis = range(self.values.ndim)[axis]
        refuse(axis == 0, "a sum over scans")
        return _recorded("sum", methodcaller("sum", axis), _real(self), detail=axis)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of scans, and shape of what each has."""
        return self.values.shape

    @property
    def dtype(self) -> Any:
        """`real` or bool."""
        return self.values.dtype

    @property
    def size(self) -> int:
        """Number of elements that each scan has."""
        return prod(self.shape[1:])

    @property
    def is_reshaped(self) -> bool:
        """It has all elements of its input in their order."""
        return self.operation == "moved" and np.array_equal(self.detail.reshape(-1), np.arange(self.inputs[0].size))

    @cached_property
    def steps(self) -> "list[Traced]":
        """All that it is made of, inputs before what is made of them, itself last."""
        return [*dict.fromkeys(step for each in self.inputs for step in each.steps), self]


def refuse(if_so: Any, what: str) -> None:
    """Refuse a model that does what no exported form does."""
    if if_so:
        raise ExportError(
            f"models that need {what} are not exported, such as those of finite strain: decode in Python or torch, or "
            "train on linear samples alone."
        )


def _given(values: Any, ndim: int) -> Traced:
    """An operand of a result of `ndim` dimensions."""
    if isinstance(values, Traced):
        return values
    values = np.asarray(values)
    values = values.reshape((1,) * (ndim - values.ndim) + values.shape)
    refuse((values != values[:1]).any(), "an operation that tells scans apart")
    return Traced(values[:1].astype(bool if values.dtype == bool else float), None, "constant")


def _recorded(operation: str, function: Callable[..., Any], *inputs: Traced, detail: Any = None) -> Traced:
    """What a function gives, and that it did."""
    real = next(each.real for each in inputs if each.operation != "constant")
    arrays = (each.values.astype(bool if each.dtype == bool else real, copy=False) for each in inputs)
    return Traced(function(*arrays), real, operation, inputs, detail)


def _real(values: Traced) -> Any:
    if values.operation == "constant":
        return _given(values.values.astype(float), 0)
    return np.where(values, 1.0, 0.0) if values.dtype == bool else values


def _applied(function: Callable[..., Any], *given: Any) -> Traced:
    """An operation on elements. Sums of constants become one, and factors of matrix products go into the matrices."""
    name = function.__name__
    refuse(name not in ELEMENTWISE, name)
    ndim = max(len(getattr(each, "shape", ())) for each in given)
    inputs = [_given(each, ndim) for each in given]
    refuse(any(len(each.shape) != ndim for each in inputs), "an operation that mixes scans")
    if name not in ("where", "bitwise_and", "bitwise_or", "invert"):
        inputs = [*map(_real, inputs)]
    if name in ("add", "multiply") and inputs[0].operation == "constant":
        inputs.reverse()
    first, last = inputs[0], inputs[-1]
    if last.operation == "constant":
        if name == "power" and np.all(last.values == 1.0):
            return first
        if name == "power" and np.all(last.values == 2.0):
            return first * first
        if name == "power" and np.all(last.values == 0.5):
            return _applied(np.sqrt, first)
        if name == "add" and first.operation == "add" and first.inputs[1].operation == "constant":
            return first.inputs[0] + (first.inputs[1].values + last.values)
        if name == "multiply" and last.size == last.shape[-1] and (scaled := _scaled(first, last)) is not None:
            return scaled
    return _recorded(name, function, *inputs)


def _scaled(product: Traced, factor: Traced) -> Traced | None:
    """A sum of products with constant matrices times factors of its columns; None if it is no such sum."""
    if product.operation == "constant":
        return _given(product.values * factor.values, 1)
    if product.operation == "matmul" and product.inputs[1].operation == "constant":
        return product.inputs[0] @ (product.inputs[1].values[0] * factor.values.reshape(-1))
    if product.operation != "add":
        return None
    left, right = (_scaled(each, factor) for each in product.inputs)
    return None if left is None or right is None else _applied(np.add, left, right)


def _product(left: Any, right: Any) -> Traced:
    """A matrix product; of a concatenation it is the sum of its parts' products."""
    known, dims = [not isinstance(each, Traced) for each in (left, right)], (len(left.shape), len(right.shape))
    apart = dims[1] == 2 if known[1] else dims[1] > 2 and dims[0] == (2 if known[0] else dims[1])
    refuse(not apart, "a matrix product that mixes scans")
    if not known[1]:
        return _recorded("matmul", np.matmul, _given(left, 3), right)
    if left.operation == "concat":
        rows = np.split(right, np.cumsum([part.size for part in left.inputs])[:-1])
        parts = [*zip(left.inputs, rows, strict=True)]
        terms = [part.reshape(len(part), -1) @ matrix for part, matrix in parts if part.operation != "constant"]
        terms += [part.values.reshape(1, -1) @ matrix for part, matrix in parts if part.operation == "constant"]
        return reduce(add, terms)
    return _recorded("matmul", lambda values, matrix: values @ matrix[0], left, _given(right, 3))


def _moved(move: Callable[..., Any], *given: Any) -> Any:
    """What a function gives that only moves elements of arrays, by what it does to their numbers."""
    parts = [_given(each, len(each.shape)) for each in given]
    n, ends = max(map(len, given)), np.cumsum([part.size for part in parts])
    numbers = np.arange(n * ends[-1]).reshape(n, -1)
    by_part = zip(np.split(numbers, ends[:-1], axis=1), parts, strict=True)
    places = move(*(rows.reshape(n, *part.shape[1:]) for rows, part in by_part))
    mixed = places.shape[:1] != (n,) or np.ptp(places.reshape(n, -1) - numbers[:, :1], axis=0).any()
    refuse(mixed, "a move of elements from scan to scan")
    if len(parts) == 1:
        return _taken(parts[0], places[0])
    inputs = [each for part in parts for each in (part.inputs if part.operation == "concat" else [part])]
    flat = _recorded(
        "concat",
        lambda *rows: np.hstack([np.repeat(row.reshape(len(row), -1), n // len(row), axis=0) for row in rows]),
        *inputs,
    )
    return _taken(flat, places[0])


def _taken(source: Traced, places: NDArray[Any]) -> Any:
    """Elements at places (...) of what is laid flat of each scan."""
    if source.operation == "moved":
        return _taken(source.inputs[0], source.detail.reshape(-1)[places])
    if source.operation == "concat" and places.size:
        ends = np.cumsum([part.size for part in source.inputs])
        first, last = np.searchsorted(ends, [places.min(), places.max()], side="right")
        part, within = source.inputs[first], places - ends[first] + source.inputs[first].size
        if first == last and part.operation == "constant":
            return np.array([part.values.reshape(-1)[within]] * len(source))
        if first == last:
            return _taken(part, within)
    if places.shape == source.shape[1:] and np.array_equal(places.reshape(-1), np.arange(source.size)):
        return source
    return _recorded("moved", lambda values: values.reshape(len(source), -1)[:, places], source, detail=places)
