"""From an array's response to labelled training data.

In: a response (influence matrix) and a load protocol. Out: `Samples`, that is tractions, forces, displacements, pillar
lengths and resistances of many samples, in memory, as a NetCDF file or a zarr directory. Begin with `simulation.py`,
which goes from loads (`protocols.py`, within the ranges of `loads.py`) to resistances as a real sensor reads them
(`imperfections.py`), and with `variables.py`, which says what samples hold. Names are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from common.lazy import lazily

if TYPE_CHECKING:
    from dataset.imperfections import OPEN_OHM, Imperfections
    from dataset.measurement import counts_from_resistance, measured, resistance_from_counts
    from dataset.resistance import pillar_lengths, pillar_resistances, rest_resistances
    from dataset.samples import SampleError, Samples
    from dataset.settings import DatasetSettings
    from dataset.simulation import measured_again, simulate
    from dataset.stored import in_memory, read_samples

__all__ = [
    "OPEN_OHM",
    "DatasetSettings",
    "Imperfections",
    "SampleError",
    "Samples",
    "counts_from_resistance",
    "in_memory",
    "measured",
    "measured_again",
    "pillar_lengths",
    "pillar_resistances",
    "read_samples",
    "resistance_from_counts",
    "rest_resistances",
    "simulate",
]

__getattr__ = lazily(__name__)
