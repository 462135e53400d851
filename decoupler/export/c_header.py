"""A trained network as one C99 header for a microcontroller: constants and a function, no memory to manage."""

import subprocess
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from textwrap import fill

import numpy as np

from dataset.measurement import SENSE_OHM
from decoupler.data.columns import DEAD_OHM, MAX_COUNTS_FROM_REST, MIN_RESTING
from decoupler.export.portable import ExportError, dead_inputs, facts, output_weights_n, places
from decoupler.inverse.forward_model import MIN_WHOLE_OHM
from decoupler.model.decoupler import Decoupler
from geometry.layout import PILLARS, FloatArray

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")  #: the header passes them

_TOP = """\
/* Forces on a tactile sensor from the resistances of its pillars, by a trained network. Written by tripillar export.

$facts

Flash: $flash bytes of constants, and the code. RAM: $stack bytes on the stack while it runs, beside the two arrays that
the caller gives ($given bytes). Needs <math.h>.

Where constants do not stay in flash of their own accord (AVR), define TRIPILLAR_MEM and TRIPILLAR_READ before including
this file:
    #define TRIPILLAR_MEM PROGMEM
    #define TRIPILLAR_READ(x) pgm_read_float(&(x)) */

#ifndef TRIPILLAR_H
#define TRIPILLAR_H

#include <math.h>

#ifndef TRIPILLAR_MEM
#define TRIPILLAR_MEM
#endif
#ifndef TRIPILLAR_READ
#define TRIPILLAR_READ(x) (x)
#endif

"""

_FUNCTION = """\
$resting/* Forces [N] of one scan.
   resistance_ohm[TRIPILLAR_RESISTANCES]: by row, column and pillar (z, x, y) [ohm], each finite and above 0; dead
   pillars and those that the model does not take may hold anything.
   force_n[TRIPILLAR_FORCES]: by row, column and axis ($axes) [N]. */
static inline void tripillar_forces(const $real *resistance_ohm, $real *force_n)
{
    $real input[TRIPILLAR_INPUTS], hidden[TRIPILLAR_HIDDEN];
$workspace$counting    for (int i = 0; i < TRIPILLAR_INPUTS; i++) {
$reading    }
$inverse    for (int i = 0; i < TRIPILLAR_INPUTS; i++)
        input[i] = (input[i] - TRIPILLAR_READ(tripillar_input_centre[i])) * TRIPILLAR_READ(tripillar_input_factor[i]);
    for (int j = 0; j < TRIPILLAR_HIDDEN; j++) {
        $real sum = TRIPILLAR_READ(tripillar_hidden[j][TRIPILLAR_INPUTS]);
        for (int i = 0; i < TRIPILLAR_INPUTS; i++)
            sum += TRIPILLAR_READ(tripillar_hidden[j][i]) * input[i];
        hidden[j] = tanh$f(sum);
    }
    for (int k = 0; k < TRIPILLAR_FORCES; k++) {
        $real sum = TRIPILLAR_READ(tripillar_output[k][$bias]);
        for (int j = 0; j < TRIPILLAR_HIDDEN; j++)
            sum += TRIPILLAR_READ(tripillar_output[k][j]) * hidden[j];
$skip        force_n[k] = sum;
    }
}

#endif
"""

_SKIP = """\
        for (int i = 0; i < TRIPILLAR_INPUTS; i++)
            sum += TRIPILLAR_READ(tripillar_output[k][TRIPILLAR_HIDDEN + i]) * input[i];
"""

#: as Resting.settled
_RESTING = """\
/* Whether a converter cannot tell a reading [ohm] of input i from rest. */
static inline int tripillar_rests(const $real *resistance_ohm, int i)
{
    const $real rest = TRIPILLAR_READ(tripillar_rest_ohm[i]);
$given    const $real share = fabs$f($sense / (ohm + $sense) - $sense / (rest + $sense));
    return share * TRIPILLAR_READ(tripillar_full_counts[0]) <= $half;
}

"""

_COUNTING = """\
    int resting = 0;
    for (int i = 0; i < TRIPILLAR_INPUTS; i++)
        resting += tripillar_rests(resistance_ohm, i);
"""

_SETTLED = """\
        if (resting > $most * TRIPILLAR_INPUTS && tripillar_rests(resistance_ohm, i))
            ohm = TRIPILLAR_READ(tripillar_rest_ohm[i]);
"""

_WORKSPACE = """\
    $real length[TRIPILLAR_INPUTS], residual[TRIPILLAR_INPUTS]; /* [mm] */
    $real moved[TRIPILLAR_COMPONENTS * TRIPILLAR_ELECTRODES]; /* [mm] */
"""

#: as ModelInverse.forces; `input` holds the forces, of which there are as many as pillars
_INVERSE = """\
    for (int step = 0;; step++) {
        for (int i = 0; i < TRIPILLAR_INPUTS; i++)
            for (int k = 0; k < TRIPILLAR_INPUTS; k++)
                input[k] += residual[i] * TRIPILLAR_READ(tripillar_correctors[step][i][k]);
        if (step == TRIPILLAR_STEPS - 1)
            break;
        for (int e = 0; e < TRIPILLAR_COMPONENTS * TRIPILLAR_ELECTRODES; e++)
            moved[e] = 0;
        for (int k = 0; k < TRIPILLAR_INPUTS; k++)
            for (int e = 0; e < TRIPILLAR_COMPONENTS * TRIPILLAR_ELECTRODES; e++)
                moved[e] += input[k] * TRIPILLAR_READ(tripillar_influence[k][e]);
        for (int i = 0; i < TRIPILLAR_INPUTS; i++) {
            $real square = 0;
            for (int part = 0; part < TRIPILLAR_COMPONENTS; part++) {
                const $real d = moved[part * TRIPILLAR_ELECTRODES + tripillar_top[i]]
                    + TRIPILLAR_READ(tripillar_rest_mm[part][i]);
                square += $signed;
            }
            residual[i] = length[i] - sqrt$f(square > 0 ? square : 0);
        }
    }
"""

_FEATURE = {
    "resistance": "        input[i] = ohm;\n",
    "root": "        input[i] = sqrt$f(ohm);\n",
    "inverse": """\
        ohm -= TRIPILLAR_READ(tripillar_offset_ohm[i]);
        length[i] = sqrt$f((ohm > $least_ohm ? ohm : $least_ohm) / TRIPILLAR_READ(tripillar_ohm_per_mm2[i]));
        residual[i] = length[i] - TRIPILLAR_READ(tripillar_centre_mm[i]);
        input[i] = TRIPILLAR_READ(tripillar_centre_n[i]);
""",
}

_MAIN = """\
#include <stdio.h>
#include "model.h"

int main(void)
{
    static $real resistance_ohm[TRIPILLAR_RESISTANCES], force_n[TRIPILLAR_FORCES];
    while (fread(resistance_ohm, sizeof resistance_ohm, 1, stdin) == 1) {
        tripillar_forces(resistance_ohm, force_n);
        fwrite(force_n, sizeof force_n, 1, stdout);
    }
    return 0;
}
"""


def header_text(decoupler: Decoupler, dtype: type[np.floating]) -> str:
    """The text of a header that computes what `Decoupler.forces` does, without its refusals.

    Parameters
    ----------
    decoupler : Decoupler
    dtype : type
        ``numpy.float32`` or ``numpy.float64``: C's float or double, for all constants and calculations.

    Returns
    -------
    str
        C99, also C++; the function ``tripillar_forces(resistance_ohm, force_n)`` takes one scan (rows, cols, 3) [Ω]
        and gives (rows, cols, n_axes) [N].
    """
    network, inverse = decoupler.network, decoupler.inverse
    place, dead = places(decoupler), dead_inputs(decoupler)
    output = output_weights_n(decoupler)
    numbers = {
        "input_centre": decoupler.input_scaling.centre,
        "input_factor": decoupler.input_scaling.factor,
        "hidden": decoupler.hidden_weights,
        "output": output,
    }
    indices = {"place": np.where(dead, -1, place)}
    sizes = {
        "ROWS": decoupler.rows,
        "COLS": decoupler.cols,
        "RESISTANCES": decoupler.rows * decoupler.cols * len(PILLARS),
        "INPUTS": len(place),
        "HIDDEN": network.hidden,
        "FORCES": len(output),
    }
    working = len(place) + network.hidden
    reading = "        $real ohm = resistance_ohm[tripillar_place[i]];\n"
    if dead.any():
        reading = "        $real ohm = tripillar_place[i] < 0 ? $dead_ohm : resistance_ohm[tripillar_place[i]];\n"
    given = reading.replace("$real ohm", "const $real ohm")[4:]
    if decoupler.resting is not None:
        numbers |= {"rest_ohm": decoupler.resting.rest_ohm, "full_counts": decoupler.resting.full_counts}
        reading += _SETTLED
    if inverse is not None:
        forward = inverse.forward
        sizes["STEPS"] = len(inverse.correctors)
        sizes["COMPONENTS"] = len(forward.rest_mm)
        sizes["ELECTRODES"] = forward.influence.shape[1] // len(forward.rest_mm)
        working += 2 * len(place) + forward.influence.shape[1]
        indices["top"] = forward.top
        numbers |= {name: getattr(inverse, name) for name in ("centre_n", "centre_mm", "correctors")}
        numbers |= {name: getattr(forward, name) for name in ("influence", "rest_mm", "ohm_per_mm2", "offset_ohm")}
        numbers |= {} if forward.sign is None else {"sign": forward.sign}
    size = np.dtype(dtype).itemsize
    known = {
        "facts": "\n".join(f"{name}: {value}" for name, value in facts(decoupler).items()).replace("*/", "* /"),
        "flash": size * sum(array.size for array in numbers.values()) + 2 * len(place) * len(indices),
        "stack": size * working,
        "given": size * (sizes["RESISTANCES"] + len(output)),
        "axes": ", ".join(decoupler.component.forces),
        "real": _real(dtype),
        "f": "f" if dtype is np.float32 else "",
        "bias": "TRIPILLAR_HIDDEN + TRIPILLAR_INPUTS" if network.net == "skip" else "TRIPILLAR_HIDDEN",
        "least_ohm": _literal(dtype(MIN_WHOLE_OHM)),
        "dead_ohm": _literal(dtype(DEAD_OHM)),
        "sense": _literal(dtype(SENSE_OHM)),
        "half": _literal(dtype(MAX_COUNTS_FROM_REST)),
        "most": _literal(dtype(MIN_RESTING)),
    }
    has_signs = inverse is not None and inverse.forward.sign is not None
    known["signed"] = "TRIPILLAR_READ(tripillar_sign[part][i]) * d * d" if has_signs else "d * d"
    known["given"] = Template(given).substitute(known)
    known["resting"] = "" if decoupler.resting is None else Template(_RESTING).substitute(known)
    known["counting"] = "" if decoupler.resting is None else _COUNTING
    known["reading"] = Template(reading + _FEATURE[network.feature]).substitute(known)
    known["workspace"] = Template("" if inverse is None else _WORKSPACE).substitute(known)
    known["inverse"] = Template("" if inverse is None else _INVERSE).substitute(known)
    known["skip"] = _SKIP if network.net == "skip" else ""
    macros = "".join(f"#define TRIPILLAR_{name} {value}\n" for name, value in sizes.items())
    tables = [_table("short", name, array, "") for name, array in indices.items()]
    tables += [_table(_real(dtype), name, array.astype(dtype), "TRIPILLAR_MEM ") for name, array in numbers.items()]
    return Template(_TOP).substitute(known) + "\n".join([macros, *tables, Template(_FUNCTION).substitute(known)])


def compiled_forces(
    header: str, resistance_ohm: FloatArray, shape: tuple[int, ...], dtype: type[np.floating], compiler: str
) -> FloatArray:
    """Forces that a header gives once compiled, (n, rows, cols, 3) [Ω] -> (n, *shape) [N].

    Raises
    ------
    ExportError
        If the compiler refuses the header under `STRICT`.
    """
    with TemporaryDirectory() as folder:
        (Path(folder) / "model.h").write_text(header, encoding="utf-8")
        (Path(folder) / "main.c").write_text(Template(_MAIN).substitute(real=_real(dtype)), encoding="utf-8")
        built = subprocess.run(
            [compiler, *STRICT, "main.c", "-o", "main", "-lm"],
            cwd=folder,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            check=False,
        )
        if built.returncode:
            raise ExportError(f"{compiler} refuses the header: {built.stderr.strip().splitlines()[0]}")
        readings = resistance_ohm.astype(dtype).tobytes()
        done = subprocess.run([Path(folder) / "main"], input=readings, capture_output=True, check=True)
    return np.frombuffer(done.stdout, dtype).astype(np.float64).reshape(-1, *shape)


def _real(dtype: type[np.floating]) -> str:
    return "float" if dtype is np.float32 else "double"


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
