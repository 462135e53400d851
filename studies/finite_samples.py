"""Accuracy of samples at finite strain: samples drawn at random against Newton's method on a much finer grid.

    python -m studies.finite_samples --rows 3 --samples 10

takes minutes for an array of 3 × 3 units, hours and 10 GB for one of 6 × 6. Every line is a sample: protocol, number,
largest pressure [MPa], largest strain, what linear elasticity gets wrong, error and its estimate [%].

    python -m studies.finite_samples --model model.safetensors --data test.nc

prints how a model decodes samples: errors of its network and of its posterior, and how often its half-widths hold.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from dataset import DatasetSettings, pillar_lengths
from dataset.finite_strain import GROUP, GroupSolver
from dataset.resistance import pillar_strains
from dataset.stored import read_samples
from decoupler.model.model_file import read_model
from fem.array.solving import array_response
from fem.finite.newton import UnreachableLoadError, find_equilibrium
from fem.finite.preloads import PreloadedArray
from geometry.design import Array, Pad, SensorDesign
from geometry.layout import FloatArray

PROTOCOLS = ("contact", "three-axis")
#: 5 times as many elements as the finer grid of the samples; with its own linear correction, as these have
REFERENCE = (0.06, 0.25, 0.75, 0.94, 1.0), (0.1, 0.3, 0.7, 0.9, 1.0)


def reference(array: PreloadedArray, influence: FloatArray, force_n: FloatArray) -> FloatArray:
    """Displacements (k, 2, 3) of the electrodes under forces (k, 3) by Newton's method, corrected as samples are."""
    state = find_equilibrium(array.system(force_n)).state
    moved = array.electrodes(state.shift[None], state.rotation[None])[0].ravel()
    return (moved + (influence - array.influence) @ (array.forces_of @ moved)).reshape(-1, 2, 3)


def decoded(model_file: Path, data_file: Path) -> None:
    """Print errors fx / fy / fz in % of full scale: rms, median and worst sample; and shares within half-widths."""
    model, data = read_model(model_file), read_samples(data_file)[:]
    true = data.force_n
    full = np.abs(true).max(axis=(0, 1, 2)) / 100
    columns = model.columns(data.resistance_ohm)
    begun = time.process_time()
    found = model.refined(columns)
    seconds = time.process_time() - begun
    for name, force_n in (("network", model.first_answers(columns)), ("posterior", found.force_n)):
        squares = ((force_n.reshape(true.shape) - true) / full) ** 2
        each = np.sqrt(squares.mean(axis=(1, 2)))
        values = {"rms": np.sqrt((each**2).mean(axis=0)), "median": np.median(each, axis=0), "worst": each.max(axis=0)}
        print(name, *(f"{key} " + " / ".join(f"{x:.2f}" for x in value) for key, value in values.items()), sep="  ")
    off = np.abs(found.force_n.reshape(true.shape) - true)
    for share, half in zip((68, 95), model.half_widths(data.resistance_ohm), strict=True):
        print(f"within {share} %: " + " / ".join(f"{100 * x:.1f}" for x in (off < half).mean(axis=(0, 1, 2))))
    print(f"{1000 * seconds / len(data):.2f} ms a sample")


def main() -> None:
    """Print a line a sample, and means by protocol and pressure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=3)
    parser.add_argument("--samples", type=int, default=10, help="of each protocol")
    parser.add_argument("--model", type=Path)
    parser.add_argument("--data", type=Path, help="samples that --model decodes, at finite strain")
    asked = parser.parse_args()
    if asked.model:
        decoded(asked.model, asked.data)
        return
    design = replace(SensorDesign(), array=Array(rows=asked.rows, cols=asked.rows), pad=Pad(kind="stiff"))
    response, _, _ = array_response(design)
    influence = response.influence_mm_per_n.reshape(6 * design.n_units, -1)
    fine = PreloadedArray(design, *REFERENCE)
    rows = []
    for protocol in PROTOCOLS:
        settings = DatasetSettings(protocol=protocol, samples=asked.samples, seed=17)
        solver = GroupSolver(response, settings)
        for number in range(-(-asked.samples // GROUP)):
            group = solver.group(settings, number)
            for sample in range(min(GROUP, asked.samples - number * GROUP)):
                force = group.traction_mpa[sample] * design.pad.size_mm**2
                try:
                    truth = reference(fine, influence, force)
                except UnreachableLoadError as error:
                    print(f"{protocol:12} {number * GROUP + sample:4d}  no reference: {error}", flush=True)
                    continue
                strain = pillar_strains(truth, pillar_lengths(truth, design.unit), design.unit).max()
                size = float(np.linalg.norm(truth))
                off = float(np.linalg.norm(group.displacement_mm[sample] - truth)) / size
                linear = float(np.linalg.norm((influence @ force.ravel()).reshape(truth.shape) - truth)) / size
                pressure = float(-group.traction_mpa[sample, :, 2].min())
                rows.append((protocol, pressure, off, float(group.error_estimate[sample])))
                print(
                    f"{protocol:12} {number * GROUP + sample:4d}  {pressure:.2f} MPa  strain {strain:.3f}  linear "
                    f"{100 * linear:5.2f} %  error {100 * off:5.2f} %  estimate {100 * rows[-1][3]:5.2f} %",
                    flush=True,
                )
    for name, low, high in (("up to 3 MPa", 0.0, 3.0), ("3 to 5 MPa", 3.0, np.inf)):
        own = [(off, estimate) for _, pressure, off, estimate in rows if low <= pressure < high]
        if own:
            mean, estimated = np.mean(own, axis=0)
            print(f"{name}: {len(own)} samples, mean error {100 * mean:.2f} %, estimated {100 * estimated:.2f} %")


if __name__ == "__main__":
    main()
