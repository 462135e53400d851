"""Accuracy of a decoder at finite strain: ``python -m studies.finite_samples --model M.safetensors --data TEST.nc``.

Errors of its network and of its posterior, and how often its half-widths hold.
"""

import time
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dataset.stored import read_samples
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model_file import read_network
from studies.program import run_alone


def decoded(
    model: Annotated[Path, Parameter(help="Model file.")],
    data: Annotated[Path, Parameter(help="Samples that it decodes, at finite strain.")],
) -> None:
    """Print errors fx / fy / fz in % of full scale: rms, median and worst sample; and shares within half-widths."""
    decoder, samples = read_network(model), read_samples(data)[:]
    if not isinstance(decoder, DecouplerAtStrain):
        raise SystemExit(f"{model} knows no finite strain: give a model of samples at finite strain.")
    true = samples.force_n
    full = np.abs(true).max(axis=(0, 1, 2)) / 100
    columns = decoder.columns(samples.resistance_ohm)
    begun = time.process_time()
    refined_n, _ = decoder.refined(columns)
    seconds = time.process_time() - begun
    for name, force_n in (("network", decoder.first_answers(columns)), ("posterior", refined_n)):
        squares = ((force_n.reshape(true.shape) - true) / full) ** 2
        each = np.sqrt(squares.mean(axis=(1, 2)))
        values = {"rms": np.sqrt((each**2).mean(axis=0)), "median": np.median(each, axis=0), "worst": each.max(axis=0)}
        print(name, *(f"{key} " + " / ".join(f"{x:.2f}" for x in value) for key, value in values.items()), sep="  ")
    off = np.abs(refined_n.reshape(true.shape) - true)
    for share, half in zip((68, 95), decoder.half_widths(samples.resistance_ohm), strict=True):
        print(f"within {share} %: " + " / ".join(f"{100 * x:.1f}" for x in (off < half).mean(axis=(0, 1, 2))))
    print(f"{1000 * seconds / len(samples):.2f} ms a sample")


if __name__ == "__main__":
    run_alone(decoded)
