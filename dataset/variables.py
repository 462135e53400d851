"""Variables of a dataset file: their dims, units and limits, the same in NetCDF and zarr."""

from typing import Any

from dataset.imperfections import OPEN_OHM
from geometry.layout import AXES, ELECTRODES, PILLARS

#: every variable of a dataset file: its dims and attributes
VARIABLES: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "traction_mpa": (
        ("sample", "row", "col", "axis"),
        {"units": "MPa", "note": "force over the pad's area, as applied: z < 0 pushes down"},
    ),
    "force_n": (("sample", "row", "col", "axis"), {"units": "N", "note": "z > 0 is compression"}),
    "displacement_mm": (
        ("sample", "row", "col", "electrode", "axis"),
        {"units": "mm", "note": "upper electrodes"},
    ),
    "length_mm": (("sample", "row", "col", "pillar"), {"units": "mm", "note": "between electrode centroids"}),
    "resistance_ohm": (
        ("sample", "row", "col", "pillar"),
        {"units": "ohm", "note": f"as measured, noise included; {OPEN_OHM:g} where a pillar cannot be read"},
    ),
}
#: variables of conduction alone
CONDUCTED: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "effective_length_mm": (
        ("sample", "row", "col", "pillar"),
        {"units": "mm", "note": "that eq. 1 would need for the pillar's exact resistance, of conduction"},
    ),
}
ARRAYS = VARIABLES | CONDUCTED
#: variables (sample,) of samples at finite strain, and their attributes
SOLVED: dict[str, dict[str, Any]] = {
    "strain_model": {"flag_values": [0.0, 1.0], "flag_meanings": "linear neo-hookean", "note": "model of the rubber"},
    "error_estimate": {"units": "1", "note": "of the displacements, relative"},
    "iterations": {"units": "1", "note": "solves of the sample, one factor for all"},
}
#: limits that no sensor exceeds: a hundred tonnes on a pad, a superconductor, an insulator; none overflows when squared
MAX_N, MIN_OHM, MAX_OHM = 1e6, 1e-9, 1e15
COORDINATES = {"axis": list(AXES), "pillar": list(PILLARS), "electrode": list(ELECTRODES)}
