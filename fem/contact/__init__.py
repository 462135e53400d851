"""A rigid indenter pressed into the array's top, and dragged along it: contact by shape.

In: a design, a shape, a depth. Out: tractions on the top, forces on every unit, displacements of the electrodes. In the
order of the data: `shapes.py` (sphere, cylinder, flat punch, capsule, convex body, solid of an STL file), `tiles.py`
(grids on the top), `compliance.py` (how the top gives way, on tiles and on the fine grid of one contact), `surface.py`
(what solves for it, cached), `indentation.py` (what is asked of a contact, one increment of it in balance, and what is
known of it), `driver.py` (increment by increment, and as fast as simulators move a shape: open this file
first), `finite.py` (one contact at finite strain).
"""

from fem.contact.compliance import SurfaceCompliance
from fem.contact.driver import Stepper, press
from fem.contact.finite import at_finite_strain, why_tangent
from fem.contact.indentation import Contact, ContactError, Indentation, judge
from fem.contact.shapes import Capsule, Convex, Cylinder, Flat, Shape, ShapeError, Solid, Sphere, about_z, read_solid
from fem.contact.surface import surface_compliance

__all__ = [
    "Capsule",
    "Contact",
    "ContactError",
    "Convex",
    "Cylinder",
    "Flat",
    "Indentation",
    "Shape",
    "ShapeError",
    "Solid",
    "Sphere",
    "Stepper",
    "SurfaceCompliance",
    "about_z",
    "at_finite_strain",
    "judge",
    "press",
    "read_solid",
    "surface_compliance",
    "why_tangent",
]
