"""A trained network as an ONNX graph: ohms in, newtons out, everything between inside. Needs the extra `export`."""

from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from dataset.measurement import SENSE_OHM
from decoupler.data.columns import DEAD_OHM, MAX_COUNTS_FROM_REST, MIN_RESTING, Resting
from decoupler.export.portable import facts, output_weights_n
from decoupler.inverse.sensor_model import ModelInverse
from decoupler.model.decoupler import Decoupler
from decoupler.readings import MIN_WHOLE_OHM
from geometry.layout import FloatArray

OPSET, IR_VERSION = 17, 8  #: versions of 2022, so that older runtimes read it


def onnx_model(decoupler: Decoupler, dtype: type[np.floating]) -> onnx.ModelProto:
    """The graph of `Decoupler.forces` without its refusals, of inputs, outputs and constants of one type.

    From ``resistance_ohm`` (n, rows, cols, n_pillars) [Ω] to ``force_n`` (n, rows, cols, n_axes) [N], n free; what made
    it is in its metadata. A resistance that `forces` refuses gives a force that means nothing.
    """
    rows, cols, n_axes = decoupler.rows, decoupler.cols, len(decoupler.component.axes)
    n_pillars = len(decoupler.layout.pillars)
    dead = ~decoupler.readable
    graph = _Graph(dtype)
    x = graph.add("Reshape", "resistance_ohm", np.array([0, rows * cols * n_pillars]))
    x = graph.add("Gather", x, decoupler.places, axis=1)
    if dead.any():
        x = graph.add("Where", dead, np.array(DEAD_OHM), x)
    if decoupler.front.resting.knows_steps:
        x = _settled(graph, x, decoupler.front.resting)
    if decoupler.inverse is not None:
        x = _inverse(graph, x, decoupler.inverse)
    elif decoupler.form.feature == "root":
        x = graph.add("Sqrt", x)
    x = graph.add("Mul", graph.add("Sub", x, decoupler.front.scaling.centre), decoupler.front.scaling.factor)
    seen = graph.add("Tanh", graph.affine(x, decoupler.network.hidden))
    if decoupler.form.net == "skip":
        seen = graph.add("Concat", seen, x, axis=1)
    outputs = graph.affine(seen, output_weights_n(decoupler))
    graph.add("Reshape", outputs, np.array([0, rows, cols, n_axes]), to="force_n")
    kind = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "tripillar",
            [helper.make_tensor_value_info("resistance_ohm", kind, ["n", rows, cols, n_pillars])],
            [helper.make_tensor_value_info("force_n", kind, ["n", rows, cols, n_axes])],
            graph.constants,
        ),
        producer_name="tripillar",
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    helper.set_model_props(model, facts(decoupler))
    onnx.checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes and constants in the order in which they are added."""

    def __init__(self, dtype: type[np.floating]) -> None:
        self.dtype = dtype
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def add(self, operator: str, *inputs: str | np.ndarray, to: str = "", **attributes: Any) -> str:
        """Add a node whose inputs are names or constants; the name of its output."""
        name = to or f"{operator.lower()}_{len(self.nodes)}"
        names = [given if isinstance(given, str) else self._constant(given) for given in inputs]
        self.nodes.append(helper.make_node(operator, names, [name], **attributes))
        return name

    def affine(self, x: str, weights: FloatArray) -> str:
        """Add weights (m, k + 1), bias last, times x (n, k); the name of the result (n, m)."""
        return self.add("Add", self.add("MatMul", x, weights[:, :-1].T), weights[:, -1])

    def _constant(self, values: np.ndarray) -> str:
        name = f"constant_{len(self.constants)}"
        values = values.astype(self.dtype) if values.dtype.kind == "f" else values
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name


def _settled(graph: _Graph, columns_ohm: str, resting: Resting) -> str:
    """Add `Resting.settled`: readings (n, n_in) [Ω] -> the same, or rest."""
    sense = np.array(SENSE_OHM)
    shares = graph.add("Div", sense, graph.add("Add", columns_ohm, sense))
    steps = graph.add("Sub", shares, SENSE_OHM / (resting.rest_ohm + SENSE_OHM))
    steps = graph.add("Mul", graph.add("Abs", steps), resting.full_counts)
    alike = graph.add("LessOrEqual", steps, np.array(MAX_COUNTS_FROM_REST))
    ones = graph.add("Where", alike, np.array(1.0), np.array(0.0))
    most = graph.add("Greater", graph.add("ReduceMean", ones, axes=[1]), np.array(MIN_RESTING))
    return graph.add("Where", graph.add("And", alike, most), resting.rest_ohm, columns_ohm)


def _inverse(graph: _Graph, columns_ohm: str, inverse: ModelInverse) -> str:
    """Add `ModelInverse.forces`: resistances (n, n_pillars) [Ω] -> forces (n, n_forces) [N]."""
    forward = inverse.forward
    whole = graph.add("Max", graph.add("Sub", columns_ohm, forward.offset_ohm), np.array(MIN_WHOLE_OHM))
    lengths = graph.add("Sqrt", graph.add("Div", whole, forward.ohm_per_mm2))
    first, *others = inverse.correctors
    forces = graph.add(
        "Add", graph.add("MatMul", graph.add("Sub", lengths, inverse.centre_mm), first), inverse.centre_n
    )
    for corrector in others:
        moved = graph.add("MatMul", forces, forward.influence)
        moved = graph.add("Reshape", moved, np.array([0, len(forward.rest_mm), -1]))
        vectors = graph.add("Add", graph.add("Gather", moved, forward.top, axis=2), forward.rest_mm)
        squares = graph.add("Mul", vectors, vectors)
        if forward.sign is not None:
            squares = graph.add("Mul", squares, forward.sign)
        squares = graph.add("ReduceSum", squares, np.array([1]), keepdims=0)
        if forward.sign is not None:
            squares = graph.add("Max", squares, np.array(0.0))
        residual = graph.add("Sub", lengths, graph.add("Sqrt", squares))
        forces = graph.add("Add", forces, graph.add("MatMul", residual, corrector))
    return forces
