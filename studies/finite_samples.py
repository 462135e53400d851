"""``python -m studies finite-samples --model M.safetensors --data TEST.nc``: a decoder's accuracy at finite strain.

Errors of its network and of its posterior, and how often its half-widths hold.
"""

import time
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from common.errors import DesignError
from dataset.stored import read_samples
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model_file import read_network
from studies.tables import OUT, Folder, Row, Tables, report


def finite_samples(
    *,
    model: Annotated[Path, Parameter(help="Model file.")],
    data: Annotated[Path, Parameter(help="Samples that it decodes, at finite strain.")],
    out: Folder = OUT,
) -> None:
    """Judge errors fx / fy / fz in % of full scale, and shares within half-widths."""
    decoder, samples = read_network(model), read_samples(data)[:]
    if not isinstance(decoder, DecouplerAtStrain):
        raise DesignError(f"{model} knows no finite strain: give a model of samples at finite strain.")
    true = samples.force_n
    full = np.abs(true).max(axis=(0, 1, 2)) / 100
    columns = decoder.columns(samples.resistance_ohm)
    begun = time.process_time()
    refined_n, _ = decoder.refined(columns)
    ms = 1000 * (time.process_time() - begun) / len(samples)
    rows: list[Row] = []
    for name, force_n in (("network", decoder.first_answers(columns)), ("posterior", refined_n)):
        each = np.sqrt((((force_n.reshape(true.shape) - true) / full) ** 2).mean(axis=(1, 2)))
        errors = {"rms": np.sqrt((each**2).mean(axis=0)), "median": np.median(each, axis=0), "worst": each.max(axis=0)}
        rows.append({"by": name} | {key: value.tolist() for key, value in errors.items()})
    off = np.abs(refined_n.reshape(true.shape) - true)
    within = [(off < half).mean(axis=(0, 1, 2)) for half in decoder.half_widths(samples.resistance_ohm)]
    held = {f"within {part} % [%]": (100 * each).tolist() for part, each in zip((68, 95), within, strict=True)}
    tables: Tables = {"Errors fx / fy / fz [% of full scale]": rows, "The posterior": [held | {"ms a sample": ms}]}
    report(tables, out / "finite-samples.json")
