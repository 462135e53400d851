"""From an array's response to labelled training data.

In: a response (influence matrix) and a load protocol. Out: `Samples`, that is tractions, forces, displacements, pillar
lengths and resistances of many samples, in memory, as a NetCDF file or a zarr directory. In the order of the data:
`protocols.py` draws the loads, `resistance.py` turns displacements into resistances, `imperfections.py` and
`measurement.py` say what a real sensor makes of them, `simulation.py` does all of it for many samples, `samples.py`
holds them, `variables.py` says how files name them, `leaves.py` writes and `stored.py` reads what memory does not hold,
`torch_samples.py` gives samples to torch, `table.py` and `card.py` to other programs. Names that need the finite
elements or torch are loaded when they are asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dataset.imperfections import OPEN_OHM, Imperfections
from dataset.measurement import Readout, counts_from_resistance, measured, resistance_from_counts
from dataset.resistance import pillar_lengths, pillar_resistances, rest_resistances
from dataset.samples import SampleError, Samples
from dataset.stored import StoredSamples, in_memory, read_samples

if TYPE_CHECKING:
    from dataset.simulation import DatasetSettings, measured_again, simulate
    from dataset.torch_samples import TorchBatches, TorchSamples

__all__ = [
    "OPEN_OHM",
    "DatasetSettings",
    "Imperfections",
    "Readout",
    "SampleError",
    "Samples",
    "StoredSamples",
    "TorchBatches",
    "TorchSamples",
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

_LAZY = {
    "DatasetSettings": "dataset.simulation",
    "TorchBatches": "dataset.torch_samples",
    "TorchSamples": "dataset.torch_samples",
    "measured_again": "dataset.simulation",
    "simulate": "dataset.simulation",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'dataset' has no name '{name}'; it has {', '.join(__all__)}.")
