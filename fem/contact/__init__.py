"""A rigid indenter pressed into the array's top, and dragged along it: contact by shape.

In: a design, a shape, a depth. Out: tractions on the top, forces on every unit, displacements of the electrodes. In the
order of the data: `shapes.py` (sphere, cylinder, flat punch, capsule, convex body, solid of an STL file), `surface.py`
(how the top gives way under tractions, cached, and on the fine grid of one contact), `indentation.py` (unilateral
contact with friction on that grid: open this file first), `balance.py` (how one increment of it is solved),
`stepping.py` (the same step by step, as fast as simulators move a shape).
"""

from fem.contact.indentation import Contact, ContactError, press
from fem.contact.shapes import Capsule, Convex, Cylinder, Flat, Shape, ShapeError, Solid, Sphere, Turned, read_solid
from fem.contact.stepping import Stepper
from fem.contact.surface import SurfaceCompliance, surface_compliance

__all__ = [
    "Capsule",
    "Contact",
    "ContactError",
    "Convex",
    "Cylinder",
    "Flat",
    "Shape",
    "ShapeError",
    "Solid",
    "Sphere",
    "Stepper",
    "SurfaceCompliance",
    "Turned",
    "press",
    "read_solid",
    "surface_compliance",
]
