"""The designs of a sweep: Sobol, Latin hypercube or grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, log2

from common.errors import DesignError
from common.storage.files import digest
from fem.array.solving import ResponseSettings, response_cache_key
from geometry.design import SensorDesign
from geometry.design_file import design_from_dict
from tripillar.sweeps.sweep_file import Judging, Sweep
from tripillar.sweeps.variables import table_of, value_of, with_values

VERSION = 4  #: raise when the same design and settings give other metrics, so that kept rows are not reused


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One design of a sweep, or why these numbers make none."""

    cache_key: str  #: hash of the design and of how it is judged
    values: dict[str, float | str]  #: of the varied keys
    design: SensorDesign | None
    reason: str = ""  #: why there is no design


def samples_of(sweep: Sweep) -> list[Sample]:
    """The designs of a sweep in its order, each once: rounding may make two of them equal."""
    found: dict[str, Sample] = {}
    for values in points_of(sweep):
        sample = sample_at(sweep, values)
        found.setdefault(sample.cache_key, sample)
    return list(found.values())


def points_of(sweep: Sweep) -> list[tuple[float | str, ...]]:
    """The value of each variable in each design."""
    from scipy.stats import qmc

    if sweep.sampling == "grid":
        return list(product(*(variable.values for variable in sweep.variables)))
    n_variables = len(sweep.variables)
    if sweep.sampling == "sobol":
        # a Sobol sequence is balanced at powers of two; the first of the next one are taken
        shares = qmc.Sobol(n_variables, seed=sweep.seed).random_base2(ceil(log2(sweep.samples)))[: sweep.samples]
    else:
        shares = qmc.LatinHypercube(n_variables, seed=sweep.seed).random(sweep.samples)
    return [tuple(v.at(float(u)) for v, u in zip(sweep.variables, row, strict=True)) for row in shares]


def sample_at(sweep: Sweep, given: Sequence[float | str]) -> Sample:
    """The design with a value for each variable."""
    table = with_values(table_of(sweep.base), sweep.variables, given)
    values = {
        variable.name: value if isinstance(value, str) else float(value_of(table, variable.name))
        for variable, value in zip(sweep.variables, given, strict=True)
    }
    try:
        design = design_from_dict(table, "not a design")
    except DesignError as error:
        cache_key = digest("row", VERSION, table, sweep.judging)
        return Sample(cache_key=cache_key, values=values, design=None, reason=str(error))
    return Sample(cache_key=row_key(design, sweep.judging), values=values, design=design)


def row_key(design: SensorDesign, judging: Judging) -> str:
    """Hash of all that a design's row depends on."""
    response = response_cache_key(design, ResponseSettings(tolerance=judging.tolerance))
    return digest("row", VERSION, response, design, judging)
