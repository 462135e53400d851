"""A trained network as one C99 header for a microcontroller: constants and a function, no memory to manage."""

from pathlib import Path
from string import Template
from textwrap import fill

import numpy as np

from dataset.measurement import SENSE_OHM
from decoupler.data.columns import DEAD_OHM, MAX_COUNTS_FROM_REST, MIN_RESTING
from decoupler.export.portable import facts, output_weights_n
from decoupler.model.decoupler import Decoupler
from decoupler.readings import MIN_WHOLE_OHM

TEXT = Path(__file__).with_name("model.h")  #: the header but for what one model puts in the place of $ and a name


def header_text(decoupler: Decoupler, dtype: type[np.floating]) -> str:
    """The text of a header that computes what `Decoupler.forces` does, without its refusals, in C's float or double.

    C99, also C++; the function ``tripillar_forces(resistance_ohm, force_n)`` takes one scan (rows, cols, n_pillars) [Ω]
    and gives (rows, cols, n_axes) [N].
    """
    form, inverse, resting = decoupler.form, decoupler.inverse, decoupler.front.resting
    place, dead, output = decoupler.places, ~decoupler.readable, output_weights_n(decoupler)
    indices = {"place": np.where(dead, -1, place)}
    resistances = decoupler.rows * decoupler.cols * len(decoupler.layout.pillars)
    inputs = len(decoupler.front.scaling.centre)
    numbers = {
        "input_centre": decoupler.front.scaling.centre,
        "input_factor": decoupler.front.scaling.factor,
        "output": output,
    }
    if form.hidden:  # C has no empty tables
        numbers["hidden"] = decoupler.network.hidden
    macros: dict[str, object] = {
        "MATH(name)": "name##f" if dtype is np.float32 else "name",
        "RESISTANCES": resistances,
        "READ_PILLARS": len(place),
        "INPUTS": inputs,
        "HIDDEN": form.hidden,
        "SEEN": output.shape[1] - 1,
        "FORCES": len(output),
        "ROOT": int(form.feature == "root"),
        "ANY_DEAD": int(dead.any()),
        "DEAD_OHM": DEAD_OHM,
        "CONVERTER": int(resting.knows_steps),
        "STEPS": 0 if inverse is None else len(inverse.correctors),
    }
    working = inputs + form.hidden
    if resting.knows_steps:
        numbers["rest_ohm"] = resting.rest_ohm
        macros |= {"SENSE_OHM": SENSE_OHM, "FULL_COUNTS": float(resting.full_counts[0])}
        macros |= {"MAX_COUNTS_FROM_REST": MAX_COUNTS_FROM_REST, "MIN_RESTING": MIN_RESTING}
    if inverse is not None:
        forward = inverse.forward
        parts, moved = len(forward.rest_mm), forward.influence.shape[1]
        macros |= {"COMPONENTS": parts, "ELECTRODES": moved // parts, "SIGNED": int(forward.sign is not None)}
        macros["MIN_WHOLE_OHM"] = MIN_WHOLE_OHM
        working += 2 * len(place) + moved
        indices["top"] = forward.top
        numbers |= {name: getattr(inverse, name) for name in ("centre_n", "centre_mm", "correctors")}
        numbers |= {name: getattr(forward, name) for name in ("influence", "rest_mm", "ohm_per_mm2", "offset_ohm")}
        numbers |= {} if forward.sign is None else {"sign": forward.sign}
    size, real = np.dtype(dtype).itemsize, "float" if dtype is np.float32 else "double"
    said = {name: _literal(dtype(value)) if isinstance(value, float) else value for name, value in macros.items()}
    tables = [_table("short", name, array, "") for name, array in indices.items()]
    tables += [_table(real, name, array.astype(dtype), "TRIPILLAR_MEM ") for name, array in numbers.items()]
    return Template(TEXT.read_text(encoding="utf-8")).substitute(
        facts="\n".join(f"{name}: {value}" for name, value in facts(decoupler).items()).replace("*/", "* /"),
        flash=size * sum(array.size for array in numbers.values()) + 2 * len(place) * len(indices),
        stack=size * working,
        given=size * (resistances + len(output)),
        axes=", ".join(decoupler.component.forces),
        pillars=", ".join(decoupler.layout.pillar_names),
        real=real,
        macros="\n".join(f"#define TRIPILLAR_{name} {value}" for name, value in said.items()),
        tables="\n".join(tables),
    )


def _literal(value: np.generic) -> str:
    """A number in C, as short as gives it back exactly.

    >>> _literal(np.float32(0.1)), _literal(np.float64(1)), _literal(np.int64(-1))
    ('0.1f', '1.0', '-1')
    """
    return str(value) + ("f" if value.dtype == np.float32 else "")


def _table(kind: str, name: str, values: np.ndarray, where: str) -> str:
    """A constant array of any number of dimensions."""
    size = "".join(f"[{n}]" for n in values.shape)
    return f"static const {kind} tripillar_{name}{size} {where}= {{\n{_numbers(values)}\n}};\n"


def _numbers(values: np.ndarray) -> str:
    if values.ndim > 1:
        return ",\n".join(f"{{\n{_numbers(row)}\n}}" for row in values)
    return fill(", ".join(map(_literal, values)), 118, break_long_words=False, break_on_hyphens=False)
