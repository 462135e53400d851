"""Displacements of a scene's probes from those of the nodes, on any mesh and of a part between mirrors alike."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from fem.kernel.field import Places, rows_at
from fem.kernel.mirrors import flipped_rectangles, folded_point, images
from fem.kernel.system import System
from fem.scene.scene import Probe
from geometry.layout import FloatArray


def probe_rows(probe: Probe, places: Places, system: System) -> tuple[sp.csr_matrix, FloatArray]:
    """Rows (r, n_nodes) and signs (r, 3): u of a probe is Σ_r signs · (rows @ u), anywhere on the whole body."""
    mirrors, parity = system.mirrors, system.parity
    if probe.kind == "mean":
        seen = images(mirrors, parity)
        rectangles = np.array([flipped_rectangles(np.array(probe.rectangle), flipped) for flipped, _ in seen])
        rows = system.integrals(rectangles)
        return rows / rows.sum(), np.array([signs for _, signs in seen])
    place, signs = folded_point(np.array(probe.position_mm), mirrors, parity)
    return rows_at(system.body, *places.located(place[None])), signs[None]


def displacements(probes: Sequence[Probe], places: Places, system: System, u: FloatArray) -> dict[str, FloatArray]:
    """Displacement (3,) of every probe, by name, in a state (n_nodes, 3) of a system on the mesh of `places` [mm]."""
    found = {}
    for probe in probes:
        rows, signs = probe_rows(probe, places, system)
        found[probe.name] = np.asarray((signs * (rows @ u)).sum(axis=0))
    return found
