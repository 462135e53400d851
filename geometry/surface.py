"""Triangulated surfaces of CAD solids, checked before anything is made of them.

A surface that leaks or faces inward makes a mesher fill the wrong side, often without a word; `check_surface`
is the gate in front of it and of every STL file.
"""

from math import log10
from typing import TYPE_CHECKING

import numpy as np

from common.errors import GeometryError

if TYPE_CHECKING:
    from build123d import Shape
    from trimesh import Trimesh

CHORD_MM = 1e-3  #: how far a triangle may leave a curved face; the bodies drawn here are flat-faced, so none does
COINCIDENT_MM = 1e-7  #: points closer than this are one point: the CAD kernel's own precision
VOLUME_TOLERANCE = 1e-6  #: relative; see `check_surface`


def surface_from_solid(solid: "Shape") -> "Trimesh":
    """Triangulate a solid, or several that do not touch, and join the triangles of neighbouring faces.

    Every edge of a solid is divided once for both of its faces, so the triangles meet without T-junctions.
    """
    from trimesh import Trimesh

    points, corners = solid.tessellate(CHORD_MM)
    surface = Trimesh([tuple(point) for point in points], corners, process=False)
    surface.merge_vertices(digits_vertex=-round(log10(COINCIDENT_MM)))
    return surface


def check_surface(surface: "Trimesh", expected_volume_mm3: float, name: str) -> None:
    """Refuse a surface that is not closed and outward, or does not enclose its solid's volume [mm³]: `GeometryError`.

    Flat faces are triangulated exactly, so volumes differ by rounding alone: 1e-12 in double precision, 1e-7 once
    coordinates went through an STL file's single precision; a pillar of a 6 × 6 array is a hundredth. That a surface
    cuts through itself is seen by its volume only.
    """
    edges_mm = np.linalg.norm(surface.triangles - np.roll(surface.triangles, 1, axis=1), axis=2)
    flat = 2 * surface.area_faces <= COINCIDENT_MM * edges_mm.max(axis=1)  # its least height is 2·area / longest edge
    if flat.any():
        raise GeometryError(
            f"surface '{name}': {flat.sum()} of {len(flat)} triangles have no area (first: {flat.argmax()}): "
            "drop them and join their ends, or triangulate the solid anew."
        )
    if not surface.is_watertight:
        _, shares = np.unique(surface.edges_sorted, axis=0, return_counts=True)
        raise GeometryError(
            f"surface '{name}' is not watertight: {(shares != 2).sum()} of {len(shares)} edges do not belong "
            "to exactly two triangles; triangulate the solid anew or mend the holes."
        )
    if not surface.is_winding_consistent:
        raise GeometryError(f"surface '{name}' is not consistently wound: turn those triangles over that face in.")
    if surface.volume < 0:
        raise GeometryError(f"surface '{name}' faces inward (volume {surface.volume:g} mm³): turn its triangles over.")
    if not abs(surface.volume - expected_volume_mm3) <= VOLUME_TOLERANCE * expected_volume_mm3:
        raise GeometryError(
            f"surface '{name}' encloses {surface.volume:.9g} mm³, its solid {expected_volume_mm3:.9g} mm³, "
            f"which may differ by {VOLUME_TOLERANCE:g} of that: make the surface anew from the solid."
        )
