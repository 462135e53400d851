"""The array in 3-D: pillars inside a translucent slab under its pads, moved in place as loads change.

The scene moves a picture by the field under any load; `Camera` is turned by the mouse.
"""

import math
from functools import cache
from typing import Literal

import numpy as np
import pyvista as pv

from dataset.loads import PAPERS
from fem.pictures.arrays import ArrayField
from fem.pictures.deformation import (
    PAD_LIFT,
    QUANTITIES,
    Bar,
    Colour,
    DeformedPicture,
    Quantity,
    add_axes,
    add_words,
    bar_of,
    place,
)
from fem.pictures.parts import COARSE, ArrayParts, Part
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres

Shown = Colour | Literal["resistance"]
RESISTANCE: Literal["resistance"] = "resistance"  #: the one colour of the page's own: of each pillar as a whole
TITLES = {name: quantity.title for name, quantity in QUANTITIES.items()} | {RESISTANCE: "change of resistance [%]"}
HAZE = {False: 0.18, True: 0.05}  #: opacity of the slab, which on a dark ground veils the pillars
MIN_SHARE = 0.02  #: of the full scale, that colours span at least, so that noise stays pale
FULL_CHANGE_PCT = 60.0  #: full scale of a resistance: of a pillar that is strained by 30 %
BACKGROUND = {False: "#ffffff", True: "#1f262d"}  #: by whether it is dark, as the page has it
LETTERS = {False: "#21292f", True: "#e4e9ed"}
AXES_INK, CORNER = "#7d8790", (0.0, 0.0, 0.14, 0.18)  #: of the axes, to be read on both, and their part of the picture
AXES_LETTER = 0.18  #: height of their letters, of that part
LETTER, BESIDE = 0.024, 1.6  #: height of letters, of the slab's larger side; places of the names, of a letter
CHOSEN = "#ff8c00"
VIEW = (1.0, -1.65, 1.5)  #: the direction one looks from at first
STEEPEST_DEG = 89.0  #: of the camera: straight from above there is no upright
NEAREST, FARTHEST = 0.1, 5.0  #: of the distance from which all is seen


class ArrayScene:
    """A plotter with the array in it, seen under one load after the other; draws nothing by itself.

    Its full scale is that of `full_mpa` on the middle pad, at which a pad's outline is darkest.
    """

    def __init__(self, field: ArrayField, full_mpa: float = PAPERS.normal_mpa[1]) -> None:
        self._field, self._parts = field, ArrayParts(field, is_coarse=True)
        design, self._pads = field.design, "plates" if field.has_plates else "pads"
        self._full = np.zeros((design.n_units, 3))
        self._full[design.array.rows // 2 * design.array.cols + design.array.cols // 2, 2] = -full_mpa
        rest, most = (self._parts.under(field.state(share * self._full), stress=False) for share in (0.0, 1.0))
        self._picture = DeformedPicture({"": rest}, medium="live", over=[most])
        self.plotter, self.pads_bar = self._picture.plotter, self._picture.bars[-1]
        self.pillars = next(moving.mesh for moving in self._picture.moving if moving.name == "pillars")
        names = unit_names(design)
        self._letters = add_words(self.plotter, names, LETTER * max(design.slab_mm))
        add_axes(self.plotter, CORNER, AXES_INK, AXES_LETTER)
        around = np.arange((COARSE[2] + 1) ** 2).reshape(COARSE[2] + 1, -1)
        self._border = np.concatenate([around[0], around[1:, -1], around[-1, -2::-1], around[-2:0:-1, 0]])
        self.mark = pv.lines_from_points(rest[self._pads].points_mm[self._border], close=True)  #: of the chosen pad
        self.plotter.add_mesh(self.mark, color=CHOSEN, line_width=4)
        self.reach_mm = np.vstack([rest["matrix"].points_mm, *(place for _, place in names)])
        self.camera = Camera(self.plotter.camera)
        self.full_size = cache(self._full_size)  #: of a quantity, its largest value at full scale
        self.look_from_the_start()

    def _full_size(self, colour: Shown) -> float:
        if colour == RESISTANCE:
            return FULL_CHANGE_PCT
        quantity = QUANTITIES[colour]
        bar = bar_of(quantity, [self._parts.under(self._field.state(self._full), quantity.of_stress)])
        return max(-bar.low, bar.high)

    def show(
        self,
        traction_mpa: FloatArray,
        change: FloatArray,
        colour: Shown,
        scale: float,
        chosen: int,
        is_dark: bool,
        min_share: float = MIN_SHARE,
    ) -> Bar:
        """Bring the scene to tractions (n_units, 3); returns the colour bar of the pillars.

        The relative change of their resistances from rest is (rows, cols, n_pillars), the colour one of `TITLES`, the
        scale a factor of displacements as drawn; the pad of the unit `chosen` is marked. Colours span `min_share` of
        the full scale at least.
        """

        def of_resistance(part: Part) -> FloatArray:
            return np.repeat(100.0 * change.ravel(), len(part.points_mm) // change.size)

        quantity = Quantity(TITLES[colour], of_resistance) if colour == RESISTANCE else QUANTITIES[colour]
        parts = self._parts.under(self._field.state(traction_mpa), quantity.of_stress)
        bar = self._picture.recolour({"": parts}, quantity, scale, min_share * self.full_size(colour))
        pads, first = parts[self._pads], chosen * (COARSE[2] + 1) ** 2
        own = first + self._border
        lift_mm = PAD_LIFT * self._field.design.unit.height_mm
        self.mark.points = pads.points_mm[own] + scale * pads.displacement_mm[own] + (0.0, 0.0, lift_mm)
        self.plotter.set_background(BACKGROUND[is_dark])
        for letters in self._letters:
            letters.GetProperty().SetColor(pv.Color(LETTERS[is_dark]).float_rgb)
        self._picture.actors["matrix"].prop.opacity = HAZE[is_dark]
        return bar

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first: the undeformed array fills the window."""
        wide, high = self.plotter.render_window.GetSize()
        place(self.plotter.camera, self.reach_mm, VIEW, (0.0, 0.0, 1.0), wide / high)
        self.camera.set_home()

    def fit(self) -> None:
        """Fill a window of another size, unless the camera has been moved."""
        if self.camera.is_home:
            self.look_from_the_start()


def unit_names(design: SensorDesign) -> list[tuple[str, FloatArray]]:
    """Numbers of rows and columns as in files, the first with its word, and their places (3,) [mm] beside the array."""
    wide, deep, _ = np.array(design.slab_mm) / 2 + BESIDE * LETTER * max(design.slab_mm)
    x, y = unit_centres(design).reshape(design.array.rows, design.array.cols, 2).transpose(2, 0, 1)
    columns = [(str(j) if j else "col 0", np.array([at, -deep, 0.0])) for j, at in enumerate(x[0])]
    return columns + [(str(i) if i else "row 0", np.array([wide, at, 0.0])) for i, at in enumerate(y[:, 0])]


class Camera:
    """A camera of VTK that the mouse turns about its focus, moves and brings nearer; z stays upright."""

    def __init__(self, camera: pv.Camera) -> None:
        self._camera = camera

    def set_home(self) -> None:
        """Take the present place for the one from which all is seen: it bounds how far the camera goes."""
        self._middle, self._distance = np.array(self._camera.focal_point), self._camera.distance
        self._camera.up = (0.0, 0.0, 1.0)
        self.is_home = True  #: the camera has not been moved since

    def turn(self, right_deg: float, up_deg: float) -> None:
        """Turn the array to the right and up."""
        elevation = math.degrees(math.asin(-self._camera.direction[2]))
        self._camera.Azimuth(-right_deg)
        self._camera.Elevation(min(max(elevation - up_deg, -STEEPEST_DEG), STEEPEST_DEG) - elevation)
        self.is_home = False

    def approach(self, factor: float) -> None:
        """Come nearer by a factor above 1, or go away by one below."""
        least, most = (self._camera.distance / (limit * self._distance) for limit in (FARTHEST, NEAREST))
        self._camera.Dolly(min(max(factor, least), most))
        self.is_home = False

    def move(self, right: float, up: float) -> None:
        """Move the array, by fractions of the picture's height."""
        camera, before = self._camera, np.array(self._camera.focal_point)
        height = 2.0 * camera.distance * math.tan(math.radians(camera.view_angle / 2))
        across = np.cross(camera.direction, camera.up)
        across /= np.linalg.norm(across)
        focus = before - height * (right * across + up * np.cross(across, camera.direction))
        shift = self._middle + np.clip(focus - self._middle, -self._distance, self._distance) - before
        camera.position, camera.focal_point = np.array(camera.position) + shift, before + shift
        self.is_home = False
