"""From an array's response to labelled training data.

In: a response (influence matrix) and a load protocol. Out: tractions, forces, displacements, pillar lengths
and resistances of any number of samples, in memory (`SimulatedData`) and as a NetCDF file. Open
`protocols.py` for the loads, `simulate.py` for the samples, `imperfections.py` for what a real sensor does to them,
`labelled.py` for the file.
"""

from dataset.imperfections import OPEN_OHM, Imperfections
from dataset.measurement import Readout, counts_from_resistance, measured, resistance_from_counts
from dataset.resistance import pillar_lengths, pillar_resistances, rest_resistances
from dataset.samples import LabelledData, SimulatedData, read_labelled, write_dataset

__all__ = [
    "OPEN_OHM",
    "Imperfections",
    "LabelledData",
    "Readout",
    "SimulatedData",
    "counts_from_resistance",
    "measured",
    "pillar_lengths",
    "pillar_resistances",
    "read_labelled",
    "resistance_from_counts",
    "rest_resistances",
    "write_dataset",
]
