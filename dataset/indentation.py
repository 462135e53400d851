"""Samples of contact by shape: spheres, cylinders and punches pressed in and dragged; the protocol `indent`.

Their tractions are those of contact, not uniform ones on pads: a truth that no decoder's pads are a model of.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from common.storage.netcdf import Content, Named, labelled, write_netcdf
from dataset.resistance import conducted_lengths, exact_resistances, largest_strains, pillar_lengths
from dataset.samples import Samples
from fem import SolverError
from fem.contact import (
    Contact,
    ContactError,
    Cylinder,
    Flat,
    Shape,
    Sphere,
    SurfaceCompliance,
    about_z,
    judge,
    press,
    surface_compliance,
)
from fem.contact.indentation import LARGE_ERROR, MAX_ERROR
from geometry.design import SensorDesign
from geometry.layout import FloatArray

#: ranges of an indentation's sizes, in heights of the slab
RADIUS, SIDE, LENGTH, DEPTH, SLIDE = (0.3, 2.0), (0.4, 2.0), (0.5, 3.0), (0.01, 0.2), (0.0, 0.15)
FRICTION = (0.1, 1.0)
PRESSED_ONLY = 1 / 3  #: of the samples, which are not dragged
CELLS = 32  #: of a contact's grid: its force errs by 0.1 %
VERSION = 5  #: raise when the same settings give other samples
_MAKING = Lock()


def indented(
    design: SensorDesign, seed: int, cap: float, block: int, wanted: int
) -> Callable[[np.ndarray, int], tuple[list[FloatArray], np.ndarray]]:
    """A function that draws contacts of a block: by their numbers (m,) in it and how often they were drawn before.

    It gives tractions (m, n_units, 3) [MPa], forces on each unit's share of the top over the pad's area, displacements
    (m, n_units, n_upper, 3) [mm], moments (m, n_units, 2) [N mm] and, of conduction, forces on tiles (m, 3, ny, nx) [N]
    for `tiled_lengths`; 0 of numbers from `wanted` on. And which of them strain no pillar beyond the cap and are not
    refused for their error, (m,).
    """

    def draw(numbers: np.ndarray, attempt: int) -> tuple[list[FloatArray], np.ndarray]:
        surface, per_area = _surface(design), np.array([1.0, 1.0, -1.0]) / design.pad.size_mm**2
        shapes = (3,), (len(design.unit.layout.upper), 3), (2,)
        traction, displacement, moment = (np.zeros((len(numbers), design.n_units, *shape)) for shape in shapes)
        is_judged = np.ones(len(numbers), dtype=bool)
        tiled = np.zeros((len(numbers), *(surface.on_tiles.shape[:3] if surface.conducted else (0,))), np.float32)
        for place in np.flatnonzero(numbers < wanted):
            try:
                contact = judged_press(np.random.default_rng([seed, block, int(numbers[place]), attempt]), surface)
            except ContactError:  # its error is too large
                is_judged[place] = False
                continue
            traction[place] = contact.force_n.reshape(-1, 3) * per_area
            displacement[place] = contact.electrode_mm.reshape(displacement.shape[1:])
            moment[place] = contact.unit_moment_nmm.reshape(-1, 2)
            if surface.conducted:
                tiled[place] = contact.tile_force_n
        is_strained = largest_strains(displacement, design.unit) > cap
        return [traction, displacement, moment, tiled], is_judged & ~is_strained

    return draw


def samples_of(contacts: Sequence[Contact]) -> Samples:
    """Contacts with one sensor as labelled samples: force on each unit's share of the top, exact resistances."""
    design = contacts[0].design
    force = np.stack([contact.force_n for contact in contacts])
    moved = np.stack([contact.electrode_mm for contact in contacts])
    length = pillar_lengths(moved, design.unit)
    effective = contact_lengths(contacts)
    return Samples(
        force_n=force,
        traction_mpa=force * np.array([1.0, 1.0, -1.0]) / design.pad.size_mm**2,
        displacement_mm=moved,
        moment_nmm=np.stack([contact.unit_moment_nmm for contact in contacts]),
        length_mm=length,
        effective_length_mm=effective,
        resistance_ohm=exact_resistances(length if effective is None else effective, design),
        design=design,
    )


def contact_lengths(contacts: Sequence[Contact]) -> FloatArray | None:
    """Lengths (n, rows, cols, n_pillars) [mm] by which eq. 1 gives the resistances of conduction; None by eq. 1."""
    array, conducted = contacts[0].design.array, contacts[0].surface.conducted
    if conducted is None:
        return None
    found = conducted_lengths(conducted, np.stack([contact.tile_force_n for contact in contacts]))
    return found.reshape(len(contacts), array.rows, array.cols, -1)


def tiled_lengths(design: SensorDesign, tile_force_n: FloatArray, wanted: int) -> FloatArray | None:
    """The same (n, n_units, n_pillars) by forces (n, 3, ny, nx) on tiles, at rest from `wanted` on."""
    conducted = _surface(design).conducted
    if conducted is None:
        return None
    found = np.repeat(conducted_lengths(conducted, 0 * tile_force_n[:1]), len(tile_force_n), axis=0)
    found[:wanted] = conducted_lengths(conducted, tile_force_n[:wanted])
    return found


def largest_strain(contact: Contact) -> float:
    """Largest strain |l − l₀|/l₀ of a pillar."""
    return float(largest_strains(contact.electrode_mm, contact.design.unit).max())


def write_contact(contact: Contact, path: Path) -> None:
    """Write a contact as a data set of one sample, and pressure, shear, gap and displacement over its grid."""
    patch = contact.patch
    maps = {
        "pressure_mpa": Named(("y", "x"), contact.pressure_mpa, {"units": "MPa"}),
        "shear_mpa": Named(("direction", "y", "x"), contact.shear_mpa, {"units": "MPa", "note": "on the sensor"}),
        "gap_mm": Named(("y", "x"), contact.gap_mm, {"units": "mm", "note": "between shape and rubber"}),
        "moved_mm": Named(("axis", "y", "x"), contact.displacement_mm, {"units": "mm", "note": "of the top, z up"}),
        "state": Named(("y", "x"), contact.state, {"flag_values": [0, 1, 2], "flag_meanings": "open slip stick"}),
    }
    places = {"x": Named(("x",), patch.x_mm, {"units": "mm"}), "y": Named(("y",), patch.y_mm, {"units": "mm"})}
    story = {
        "depth_mm": contact.depth_mm,
        "at_mm": list(contact.at_mm),
        "slide_mm": list(contact.slide_mm),
        "friction": contact.friction,
        "error_estimate": contact.error_estimate,
        "electrode_error_estimate": contact.electrode_error_estimate,
    }
    sample = samples_of([contact]).content()
    coords = {**sample.coords, **places, **labelled({"direction": ["x", "y"]})}
    whole = Content(data_vars={**sample.data_vars, **maps}, coords=coords, attrs={**sample.attrs, **story})
    write_netcdf(whole, path)


def drawn_press(
    generator: np.random.Generator, surface: SurfaceCompliance, cells: int = CELLS, own: Shape | None = None
) -> Contact:
    """A random shape, or one's own, turned, pressed and dragged somewhere, on so many cells along its longer side."""
    design = surface.design
    height, (wide, deep, _) = design.unit.height_mm, design.slab_mm
    turn = about_z(generator.uniform(0.0, 180.0))
    shapes: tuple[Shape, ...] = (
        Sphere(height * generator.uniform(*RADIUS)),
        Cylinder(height * generator.uniform(*RADIUS), height * generator.uniform(*LENGTH), turn=turn),
        Flat((height * generator.uniform(*SIDE), height * generator.uniform(*SIDE)), turn=turn),
    )
    angle = generator.uniform(0.0, 2 * np.pi)
    slide = height * generator.uniform(*SLIDE) * (generator.uniform() >= PRESSED_ONLY)
    return press(
        surface,
        replace(own, turn=turn) if own is not None else shapes[generator.integers(len(shapes))],
        height * generator.uniform(*DEPTH),
        at_mm=(wide * generator.uniform(-0.5, 0.5), deep * generator.uniform(-0.5, 0.5)),
        slide_mm=(slide * np.cos(angle), slide * np.sin(angle)),
        friction=generator.uniform(*FRICTION),
        cells=cells,
    )


def judged_press(generator: np.random.Generator, surface: SurfaceCompliance, **given: Any) -> Contact:
    """`drawn_press`; a `ContactError` where `judge` refuses it or no balance is found. Both are said once a design."""
    try:
        contact = drawn_press(generator, surface, **given)
    except SolverError as error:
        _warn_once(surface.design)
        raise ContactError(str(error)) from None
    if judge(contact, on_grid=False) is not None:
        _warn_once(surface.design)
    return contact


@lru_cache(maxsize=64)
def _warn_once(_: SensorDesign) -> None:
    logging.getLogger("tripillar").warning(
        "the estimated error of some contacts is above %.0f %%; those above %.0f %%, or without balance, are left out",
        100 * LARGE_ERROR,
        100 * MAX_ERROR,
    )


def _surface(design: SensorDesign) -> SurfaceCompliance:
    with _MAKING:  # blocks are made side by side; the first of them makes it for all
        return _kept_surface(design)


@lru_cache(maxsize=2)
def _kept_surface(design: SensorDesign) -> SurfaceCompliance:
    return surface_compliance(design)[0]
