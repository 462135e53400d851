"""Electric conduction in the pillars of a unit, at rest and deformed.

Goes in: a unit and a field of deformation gradients. Comes out: conductances between its electrodes with an
estimate of their error. Open `potentials.py` first.
"""

from fem.conduction.potentials import Piezoresistivity, unit_conductances

__all__ = ["Piezoresistivity", "unit_conductances"]
