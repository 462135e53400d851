"""A graph of operations as an ONNX model, from ohms to newtons. Needs the extra `export`."""

from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from decoupler.export.traced import ELEMENTWISE, Traced

OPSET, IR_VERSION = 17, 8  #: versions of 2022, so that older runtimes read it


def onnx_model(force_n: Traced, facts: dict[str, str]) -> onnx.ModelProto:
    """The graph from ``resistance_ohm`` (n, ...) [Ω] to ``force_n`` (n, ...) [N], n free.

    Inputs, outputs and constants are of the type of the scans that were traced; facts are its metadata. A resistance
    that `Decoupler.forces` refuses gives a force that means nothing.
    """
    graph, steps = _Graph(force_n.real), force_n.steps
    given_ohm = next(step for step in steps if step.operation == "input")
    names: dict[Traced, str | np.ndarray] = {}
    for step in steps:
        given = [names[each] for each in step.inputs]
        match step.operation:
            case "input":
                found: str | np.ndarray = "resistance_ohm"
            case "constant":
                found = step.values
            case "matmul":
                found = graph.add("MatMul", given[0], given[1] if isinstance(given[1], str) else given[1][0])
            case "sum":
                found = graph.add("ReduceSum", *given, np.array([step.detail]), keepdims=0)
            case "concat":
                found = graph.add("Concat", *map(graph.row, given, step.inputs), axis=1)
            case "moved":
                if not step.is_reshaped:
                    given = [graph.add("Gather", graph.row(given[0], step.inputs[0]), step.detail.reshape(-1), axis=1)]
                found = graph.add("Reshape", *given, np.array([0, *step.shape[1:]]))
            case operation:
                found = graph.add(ELEMENTWISE[operation][0], *given)
        names[step] = found
    graph.add("Identity", names[force_n], to="force_n")
    kind = helper.np_dtype_to_tensor_dtype(force_n.real)
    told = [
        helper.make_tensor_value_info(name, kind, ["n", *step.shape[1:]])
        for name, step in (("resistance_ohm", given_ohm), ("force_n", force_n))
    ]
    model = helper.make_model(
        helper.make_graph(graph.nodes, "tripillar", told[:1], told[1:], [*graph.constants.values()]),
        producer_name="tripillar",
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    helper.set_model_props(model, facts)
    onnx.checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes in the order in which they are added, and each constant once."""

    def __init__(self, real: Any) -> None:
        self.real = real
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[Any, onnx.TensorProto] = {}

    def add(self, operator: str, *inputs: str | np.ndarray, to: str = "", **attributes: Any) -> str:
        """Add a node whose inputs are names or constants; the name of its output."""
        name = to or f"{operator.lower()}_{len(self.nodes)}"
        names = [given if isinstance(given, str) else self._constant(given) for given in inputs]
        self.nodes.append(helper.make_node(operator, names, [name], **attributes))
        return name

    def row(self, given: str | np.ndarray, step: Traced) -> str:
        """Add what lays values (n, ...) flat, (n, k), or gives a constant to each scan; the name of the result."""
        if isinstance(given, str):
            return given if len(step.shape) == 2 else self.add("Reshape", given, np.array([0, -1]))
        n = self.add("Shape", "resistance_ohm", start=0, end=1)
        return self.add("Expand", given.reshape(-1), self.add("Concat", n, np.array([step.size]), axis=0))

    def _constant(self, values: np.ndarray) -> str:
        values = np.ascontiguousarray(values, self.real if values.dtype.kind == "f" else None)
        key = values.dtype, values.shape, values.tobytes()
        if key not in self.constants:
            self.constants[key] = numpy_helper.from_array(values, f"constant_{len(self.constants)}")
        return self.constants[key].name
