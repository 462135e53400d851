"""A graph of operations as one C99 header for a microcontroller: constants and a function, no memory to manage."""

from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from string import Template
from textwrap import fill, indent
from typing import Any

import numpy as np

from decoupler.export.traced import ELEMENTWISE, Traced

TEXT = Path(__file__).with_name("model.h")  #: the header but for what one model puts in the place of $ and a name


def header_text(force_n: Traced, facts: dict[str, str]) -> str:
    """The text of a header that computes what `Decoupler.forces` does, without its refusals, in C's float or double.

    The type is that of the scans that were traced. C99, also C++; the function
    ``tripillar_forces(resistance_ohm, force_n)`` takes one scan (rows, cols, n_pillars) [Ω] and gives (rows, cols,
    n_axes) [N].
    """
    while force_n.is_reshaped:  # which is nothing in memory
        force_n = force_n.inputs[0]
    code, size = _Code(force_n), force_n.real.itemsize
    lines = [line for step in code.steps[1:] if step in code.place for line in code.lines(step)]
    lines = [f"tripillar_real b{k}[{n}];" for k, n in enumerate(code.memory)] + lines
    return Template(TEXT.read_text(encoding="utf-8")).substitute(
        facts="\n".join(f"{name}: {value}" for name, value in facts.items()).replace("*/", "* /"),
        flash=sum(n_bytes for n_bytes, _ in code.tables.values()),
        stack=size * sum(code.memory),
        given=size * (code.steps[0].size + force_n.size),
        real=code.kind,
        math="name##f" if code.kind == "float" else "name",
        resistances=code.steps[0].size,
        forces=force_n.size,
        tables="\n".join(text for _, text in code.tables.values()),
        code=indent("\n".join(lines), "    "),
    )


class _Code:
    """Lines of C for steps that stand in memory; others are computed where one of these needs them."""

    def __init__(self, last: Traced) -> None:
        self.real, self.kind = last.real, "float" if last.real == np.float32 else "double"
        self.steps = [step for step in last.steps if step.operation != "constant"]
        self.place = {self.steps[0]: "resistance_ohm", last: "force_n"}  #: names of arrays in memory
        self.memory: list[int] = []  #: sizes of further arrays
        self.tables: dict[Any, tuple[int, str]] = {}  #: bytes and text of constants
        self.sums = 0
        at: dict[Traced, int] = {}  # number of the step in memory where each is computed
        spans: list[tuple[int, int, Traced]] = []  # of steps in memory: their number, and of the last that reads them
        for number, step in reversed([*enumerate(self.steps)]):
            by = [each for each in self.steps for given in each.inputs if given is step]
            at[step] = until = max((at[each] for each in by), default=number)
            if step.operation not in ("input", "moved") and (
                step.operation == "concat"
                or _by_rows(step)
                or len({at[each] for each in by}) > 1
                or (len(by) > 1 and step.operation != "add")  # what is squared is rather added twice than kept
                or any(each.operation in ("moved", "matmul") for each in by)
                or any(each.operation not in ("sum", "concat") and each.shape != step.shape for each in by)
            ):
                at[step] = number
                spans.append((number, until, step))
        taken: list[list[tuple[int, int]]] = []  # spans of each array, of which the last are the smallest
        for number, until, step in sorted(spans, key=lambda span: (-span[2].size, span[0])):
            free = [k for k, others in enumerate(taken) if all(until < a or b < number for a, b in others)]
            if step is not last:
                if not free:
                    free = [len(taken)]
                    taken.append([])
                    self.memory.append(step.size)
                taken[free[-1]].append((number, until))
                self.place[step] = f"b{free[-1]}"

    def lines(self, step: Traced) -> list[str]:
        """Lines that compute all elements of a step that stands in memory."""
        found, start = list[str](), 0
        for part in step.inputs if step.operation == "concat" else (step,):
            inside, index = list[str](), _names(part.shape[1:])
            compute = self._value if part is step else self._element
            text = "0" if _by_rows(step) else compute(part, index, inside)
            to = f"{self.place[step]}[{self._position(_places(part) + start, index)}]"
            found += _looped(index, part.shape[1:], [*inside, f"{to} = {text};"])
            start += part.size
        if _by_rows(step):
            left, right = step.inputs
            sizes = *left.shape[1:], step.shape[-1]
            index = _names(sizes)
            term = f"{self._element(left, index[:-1], [])} * {self._element(right, index[-2:], [])}"
            to = self._element(step, [*index[:-2], index[-1]], [])
            found += _looped(index, sizes, [f"{to} += {term};"])
        return found

    def _element(self, step: Traced, index: Sequence[str], lines: list[str]) -> str:
        """An element of a step, whose index may have more dimensions, which are first; `lines` come before it."""
        dims = len(step.shape) - 1
        index = ["0" if n == 1 else name for n, name in zip(step.shape[1:], index[len(index) - dims :], strict=True)]
        if step.operation == "constant":
            return self._constant(step.values[0], index)
        if step in self.place:
            return f"{self.place[step]}[{self._position(_places(step), index)}]"
        return self._value(step, index, lines)

    def _value(self, step: Traced, index: list[str], lines: list[str]) -> str:
        """What an element of a step is computed by."""
        first, last = step.inputs[0], step.inputs[-1]
        if step.operation == "moved":
            return f"{self.place[first]}[{self._position(step.detail, index)}]"
        if step.operation not in ("sum", "matmul"):
            return f"({ELEMENTWISE[step.operation][1].format(*(self._element(e, index, lines) for e in step.inputs))})"
        self.sums += 1
        k, total, inside = f"k{self.sums}", f"t{self.sums}", list[str]()
        if step.operation == "sum":
            axis = step.detail - 1
            n, term = first.shape[step.detail], self._element(first, [*index[:axis], k, *index[axis:]], inside)
        else:
            n, term = first.shape[-1], self._element(first, [*index[:-1], k], inside)
            term += " * " + self._element(last, [*index[:-2], k, index[-1]], inside)
        lines += [f"tripillar_real {total} = 0;", *_looped([k], [n], [*inside, f"{total} += {term};"])]
        return total

    def _position(self, places: np.ndarray, index: Sequence[str]) -> str:
        """One of places (...) of elements: a sum of what each dimension adds, by a factor or a table; else a table."""
        origin = places.reshape(-1)[0]
        dims = range(places.ndim)
        along = [places[tuple(slice(None) if d == other else 0 for other in dims)] - origin for d in dims]
        if along and not np.array_equal(reduce(np.add.outer, along), places - origin):
            return self._constant(places, index)
        terms = [str(origin)] if origin else []
        for name, steps in zip(index, along, strict=True):
            step = steps[-1] // max(len(steps) - 1, 1)
            if not np.array_equal(steps, step * np.arange(len(steps))):
                terms.append(self._constant(steps, [name]))
            elif step:
                terms.append(name if step == 1 else f"{name} * {step}")
        return " + ".join(terms) or "0"

    def _constant(self, values: np.ndarray, index: Sequence[str]) -> str:
        """A number, or an element of a table that lies as the array does in memory."""
        values = values.astype(self.real if values.dtype.kind == "f" else int)
        if values.size == 1:
            return _literal(values.reshape(-1)[0])
        if _by_columns(values):
            values, index = values.T, index[::-1]
        kind, where = (self.kind, "TRIPILLAR_MEM ") if values.dtype == self.real else ("short", "")
        key = values.shape, kind, values.tobytes()
        if key not in self.tables:
            declared = f"tripillar_c{len(self.tables)}" + "".join(f"[{n}]" for n in values.shape)
            text = f"static const {kind} {declared} {where}= {{\n{_numbers(values)}\n}};\n"
            self.tables[key] = (values.itemsize if where else 2) * values.size, text
        element = f"tripillar_c{[*self.tables].index(key)}" + "".join(f"[{each}]" for each in index)
        return f"TRIPILLAR_READ({element})" if where else element


def _by_columns(values: np.ndarray) -> bool:
    """A matrix that lies in memory column by column."""
    return values.ndim == 2 and values.strides[0] < values.strides[1]


def _by_rows(step: Traced) -> bool:
    """A product with a constant matrix whose rows are added one by one, as they lie in memory."""
    return (
        step.operation == "matmul"
        and step.inputs[1].operation == "constant"
        and not _by_columns(step.inputs[1].values[0])
    )


def _places(step: Traced) -> np.ndarray:
    return np.arange(step.size).reshape(step.shape[1:])


def _names(shape: Sequence[int]) -> list[str]:
    return [f"i{d}" if n > 1 else "0" for d, n in enumerate(shape)]


def _looped(index: Sequence[str], shape: Sequence[int], lines: list[str]) -> list[str]:
    """Lines within loops over all elements of a shape."""
    for name, n in reversed([*zip(index, shape, strict=True)]):
        if name != "0":
            lines = [f"for (int {name} = 0; {name} < {n}; {name}++) {{", *(f"    {line}" for line in lines), "}"]
    return lines


def _literal(value: np.generic) -> str:
    """A number in C, as short as gives it back exactly.

    >>> _literal(np.float32(0.1)), _literal(np.float64(1)), _literal(np.int64(-1))
    ('0.1f', '1.0', '-1')
    """
    return str(value) + ("f" if value.dtype == np.float32 else "")


def _numbers(values: np.ndarray) -> str:
    if values.ndim > 1:
        return ",\n".join(f"{{\n{_numbers(row)}\n}}" for row in values)
    return fill(", ".join(map(_literal, values)), 118, break_long_words=False, break_on_hyphens=False)
