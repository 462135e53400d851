"""The arrays of the README and of docs/, still and moving: `python -m studies draw-arrays docs`.

Files are small: colours are rounded where nobody sees it, and the moving picture is a WebP.
"""

from pathlib import Path

import numpy as np
from PIL import Image

from common.storage.files import replacing
from dataset.loads import loads_of
from fem.array.solving import array_response
from fem.pictures.arrays import indenter_tractions, solve_array_field
from fem.pictures.deformation import DeformedPicture
from fem.pictures.parts import Parts, sensor_parts
from geometry.design import Array, SensorDesign
from geometry.layout import FloatArray
from studies.charts import save_screen
from tripillar.face.bodies import design as written
from tripillar.viewer.page.controls import traction_of
from tripillar.viewer.panels import panels_of

PRESSED_MPA, DRAGGED_MPA = 5.0, 1.0  #: of the moving picture: the most of the datasets
DOWN, ROUND = 8, 30  #: its frames: to press or to lift, and to go round
WIDE, FRAME_MS, QUALITY = 720, 80, 45
SMALL_MB = 1.0  #: that a moving picture may have: READMEs are read on phones, too


def draw(folder: Path) -> None:
    """Draw the array pressed, three pressures side by side, and an indenter that presses, drags round and lifts."""
    of_nine, finger = SensorDesign(array=Array(rows=3, cols=3)), written(purpose="finger")
    usual_mpa = loads_of(array_response(finger)[0]).middle_mpa
    for name, design, pressures in (
        ("fingertip.png", finger, (float(f"{usual_mpa:.3g}"),)),
        ("deformed-array.png", SensorDesign(), (5.0,)),
        ("tutorial-array.png", of_nine, (1.0, 3.0, 5.0)),
    ):
        picture = DeformedPicture(panels_of(design, pressures, "indenter", stress=False))
        save_screen(picture, folder / name)
    draw_moving(SensorDesign(), folder / "deforming-array.webp")


def draw_moving(design: SensorDesign, path: Path) -> None:
    """Write an animated WebP: a round indenter presses, drags once round the middle, and lifts."""
    field = solve_array_field(design)
    states = [sensor_parts(field, field.state(traction), stress=False) for traction in tour(design)]
    name = f"{PRESSED_MPA:g} MPa at the indenter's middle, dragged by {DRAGGED_MPA:g} MPa"
    picture = DeformedPicture({name: states[DOWN]}, medium="film", over=states)
    frames = [_frame(picture, {name: parts}) for parts in states]
    picture.plotter.close()
    with replacing(path) as temporary:
        frames[0].save(
            temporary, "WEBP", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, quality=QUALITY,
            method=6,
        )  # fmt: skip
        assert temporary.stat().st_size < SMALL_MB * 1e6, "too large for a README: fewer frames or less quality"


def _frame(picture: DeformedPicture, panels: dict[str, Parts]) -> Image.Image:
    picture.load(panels)
    picture.plotter.render()  # a screenshot alone takes the last picture again
    image = Image.fromarray(picture.plotter.screenshot(return_img=True))
    return image.resize((WIDE, round(image.height * WIDE / image.width)), Image.Resampling.LANCZOS)


def tour(design: SensorDesign) -> list[FloatArray]:
    """Tractions (n_units, 3) [MPa] from frame to frame: down, round the middle, up, with shear the way that it goes."""
    pitch = design.array.pitch_mm
    steps = [(share, 0.0, 0.0) for share in np.linspace(0.0, 1.0, DOWN, endpoint=False)]
    steps += [(1.0, share, np.sin(np.pi * share) ** 0.5) for share in np.linspace(0.0, 1.0, ROUND)]
    steps += [(share, 0.0, 0.0) for share in np.linspace(1.0, 0.0, DOWN)[1:]]
    found = []
    for pressed, turned, dragged in steps:
        angle = 2 * np.pi * turned - np.pi / 2
        traction = traction_of(pressed * PRESSED_MPA, dragged * DRAGGED_MPA, float(np.degrees(angle + np.pi / 2)))
        centre = 1.2 * pitch * np.cos(angle), 1.2 * pitch * np.sin(angle)
        found.append(indenter_tractions(design, traction, centre, pitch))
    return found
