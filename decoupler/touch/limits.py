"""Touches as well as a design can know them: the bound of Cramér and Rao, before a press is solved."""

from dataclasses import replace

import numpy as np

from dataset.measurement import ReadingError
from decoupler.readings import Pillars
from decoupler.touch.morph import MOVES, PRIOR, BareSensing, Part, fitted
from decoupler.touch.plates import PlateDecoder, plate_response
from decoupler.touch.presses import Grid
from fem.contact.surface import endless_surface
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres

TOUCHES, SEED = 48, 0  #: that are drawn, the same of every design
HALF_MM, FRICTION = (1.0, 6.0), 0.5  #: half axes of a touch's ellipse, and its largest shear over its pressure
CELLS = 12  #: along its patch
HELD = 1e9  #: of the curvature by a number that is known
LEAST_FORCE_SHARE = 1e-2  #: of a touch's force, by which its moment is divided at least where it is missed
REACH = 3.0  #: heights from a touch within which units feel it


def touch_limits(design: SensorDesign, force_n: float, errors: ReadingError) -> tuple[float, float]:
    """Least deviations of a touch's normal force [%] and of its centre [mm], medians over `TOUCHES` touches.

    Parameters
    ----------
    design : SensorDesign
        Of linear rubber and eq. 1. What pillars of another rubber and the slab's sides add is left out under soft pads.
    force_n : float
        Normal force of every touch.
    errors : ReadingError
        Of a reading.

    Raises
    ------
    DesignError
        If no contact is solved on such a design.

    Notes
    -----
    On bare rubber a touch is the pressure of Hertz on an ellipse, dragged. What is not known of it are the nine numbers
    by which the decoder changes a press as a whole, with their priors; readings are linear in them nearby. On stiff
    pads it is a force on a plate in the middle, decoded from an exact reading; its error, with the deviation stated.
    """
    array, height_mm = design.array, design.unit.height_mm
    n = 2 + int(np.ceil(2 * REACH * height_mm / array.pitch_mm))
    near = replace(design, array=replace(array, rows=min(array.rows, n), cols=min(array.cols, n)))
    found = (_through_plates if design.pad.kind == "stiff" else _on_rubber)(near, force_n, errors)
    net, place = np.median(found, axis=0)
    return float(net), float(place)


def _on_rubber(near: SensorDesign, force_n: float, errors: ReadingError) -> list[tuple[float, float]]:
    """Deviations of net force [%] and place [mm] of touches on bare rubber."""
    sensing = BareSensing(grid=Grid.of(endless_surface(near)), design=near, pillars=Pillars.designed(near))
    generator, found = np.random.default_rng(SEED), []
    held = np.diag(HELD * (np.arange(len(PRIOR)) >= MOVES))
    for _ in range(TOUCHES):
        part = Part.of(sensing, *_drawn(generator, near.array.pitch_mm, force_n))
        zero = np.zeros((1, len(PRIOR)))
        reading = sensing.reading(part.moved(zero))[0]
        (fit,) = fitted(reading, sensing.whitening(reading, errors), [([part], zero)], 0)
        values, slopes = replace(fit, curvature=fit.curvature + held).contacts()
        deviation = np.sqrt((slopes[0] ** 2).sum(axis=-1))
        found.append((100 * deviation[2] / values[0, 2], np.hypot(*deviation[3:5])))
    return found


def _through_plates(near: SensorDesign, force_n: float, errors: ReadingError) -> list[tuple[float, float]]:
    """The same of touches on a plate in the middle."""
    library, pillars = plate_response(near)[0], Pillars.designed(near)
    decoder = PlateDecoder(library=library, design=near, pillars=pillars, errors=errors, made_from={})
    generator, found = np.random.default_rng(SEED), []
    centres_mm, middle = unit_centres(near), near.array.rows // 2 * near.array.cols + near.array.cols // 2
    for _ in range(TOUCHES):
        off_mm, turn = near.pad.size_mm * generator.uniform(-0.5, 0.5, 2), 2 * np.pi * generator.uniform()
        shear = FRICTION * generator.uniform() * np.array([np.cos(turn), np.sin(turn)])
        load = np.zeros(library.moved_mm.shape[:2])
        load[middle] = force_n * np.array([*shear, 1.0, *off_mm, 0.0])
        moved_mm = load.ravel() @ library.moved_mm.reshape(load.size, -1)
        touched = decoder.touched(decoder.sensing.reading(moved_mm[None])[0])
        arms_mm = centres_mm - centres_mm[middle] - off_mm
        each = np.dstack([touched.load[:, :, None], touched.factors.reshape(*load.shape, -1)])
        net_n = each[:, 2].sum(axis=0)
        moments = (each[:, 3:5] + arms_mm[..., None] * each[:, 2:3]).sum(axis=0)  # about the centre of pressure
        missed_n = np.hypot(net_n[0] - force_n, np.linalg.norm(net_n[1:]))
        found.append(
            (
                100 * float(missed_n) / force_n,
                float(np.linalg.norm(moments) / max(net_n[0], LEAST_FORCE_SHARE * force_n)),
            )
        )
    return found


def _drawn(generator: np.random.Generator, pitch_mm: float, force_n: float) -> tuple[FloatArray, FloatArray]:
    """Box (4,) [mm] and forces (3, CELLS, CELLS) [N] of a touch somewhere on a unit's square."""
    at = pitch_mm * generator.uniform(-0.5, 0.5, 2)
    half = HALF_MM[0] * (HALF_MM[1] / HALF_MM[0]) ** generator.uniform(size=2)
    turn, way, friction = generator.uniform(size=3) * (np.pi, 2 * np.pi, FRICTION)
    reach = half.max()
    line = reach * ((np.arange(CELLS) + 0.5) * 2 / CELLS - 1)
    x, y = line, line[:, None]
    along, across = (x * np.cos(turn) + y * np.sin(turn)) / half[0], (y * np.cos(turn) - x * np.sin(turn)) / half[1]
    pressing = np.sqrt(np.maximum(0.0, 1.0 - along**2 - across**2))
    pressing *= force_n / pressing.sum()
    cells = pressing * np.array([friction * np.cos(way), friction * np.sin(way), 1.0])[:, None, None]
    return np.array([*(at - reach), *(at + reach)]), cells
