"""True and decoded traction side by side: `python -m studies draw-touch docs --model touch.safetensors`.

`touch.webp` shows six shapes, `touch-ball.webp` a ball that rolls over the array, decoded scan by scan as `live` does.
"""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from matplotlib.axes import Axes
from PIL import Image
from scipy.ndimage import gaussian_filter

from common.storage.files import replacing
from common.threads import one_blas_thread
from dataset.indentation import samples_of
from decoupler.touch.bare import TEMPER
from decoupler.touch.decoder import TouchDecoder, Touched
from fem.contact import Contact, Cylinder, Flat, Shape, Sphere, SurfaceCompliance, about_z, press, surface_compliance
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from studies.charts import image_of, new_figure
from studies.touched import Cone, Ring, TwoBalls, read_touch

SHAPES: tuple[tuple[str, Shape, float, tuple[float, float]], ...] = (  #: name, shape, depth [mm], place [mm]
    ("ball", Sphere(12.0), 1.2, (3.0, 5.0)),
    ("bar", Cylinder(8.0, 34.0, turn=about_z(30.0)), 0.9, (-9.0, 6.0)),
    ("punch", Flat((16.0, 10.0), turn=about_z(20.0)), 0.6, (6.0, -8.0)),
    ("cone", Cone(0.3), 1.8, (-4.0, -12.0)),
    ("ring", Ring(9.0, 3.0), 0.9, (12.0, 8.0)),
    ("two balls", TwoBalls((6.0, 8.0), 24.0, 0.1, turn=about_z(28.6)), 1.2, (0.0, 4.0)),
)
SLIDE_MM, FRICTION = (0.6, 0.2), 0.4
BALL_MM, BALL_DEPTH_MM, FRAMES, FRAME_MS, QUALITY = 15.0, 0.9, 40, 100, 60
CELL_MM, BLUR_MM, ARROWS_MM = 0.5, 1.5, 5.0  #: of the pressure's picture, and apart of shear's arrows
MPA_PER_MM, SMALLEST_MPA = 0.03, 0.02  #: of shear's arrows
TOP_MPA = 1.5  #: at which the colours of pressure end


def draw(folder: Path, *, model: Annotated[Path, Parameter(help="File of `tripillar train --touch`.")]) -> None:
    """Draw six shapes and a rolling ball with what a decoder of touch makes of their readings."""
    decoder = read_touch(model)
    surface = surface_compliance(decoder.design)[0]
    with one_blas_thread():
        _save([draw_shapes(decoder, surface)], folder / "touch.webp")
        _save(draw_ball(decoder, surface), folder / "touch-ball.webp")


def draw_shapes(decoder: TouchDecoder, surface: SurfaceCompliance) -> Image.Image:
    """Each shape pressed and dragged, above what is decoded from one scan."""
    figure = new_figure(14, 5.0, dpi=100, layout="compressed")
    columns = figure.subplots(2, len(SHAPES), sharex=True, sharey=True).T
    for k, ((name, shape, depth_mm, at_mm), pair) in enumerate(zip(SHAPES, columns, strict=True)):
        contact = press(surface, shape, depth_mm, at_mm=at_mm, slide_mm=SLIDE_MM, friction=FRICTION)
        shown = _draw_pair(pair, contact, decoder.touches(_read(decoder, contact, k))[0])
        pair[0].set_title(f"{name}\n{pair[0].get_title()}", fontsize=11)
        pair[1].set_xlabel("x [mm]")
    for axes in columns[0]:
        axes.set_ylabel("y [mm]")
    figure.colorbar(shown, ax=columns, shrink=0.9, extend="max", label="pressure [MPa]")
    return image_of(figure)


def draw_ball(decoder: TouchDecoder, surface: SurfaceCompliance, frames: int = FRAMES) -> list[Image.Image]:
    """A ball that rolls over the array, and what a follower of scans makes of each of them."""
    follower, images = decoder.follower(), []
    half = np.array(decoder.design.slab_mm[:2]) * 0.36
    for k, share in enumerate(np.linspace(0.0, 1.0, frames)):
        x, y = half * (-np.cos(np.pi * share), np.sin(2 * np.pi * share) / 2)
        contact = press(surface, Sphere(BALL_MM), BALL_DEPTH_MM, at_mm=(float(x), float(y)), friction=FRICTION)
        touch: Touched = follower.touches(_read(decoder, contact, k))[0]
        figure = new_figure(7.2, 3.5, dpi=90, layout="compressed")
        pair = figure.subplots(1, 2)
        shown = _draw_pair(pair, contact, touch)
        for found in touch.contacts:
            pair[1].plot(*found.centre_mm, "+", color="white", ms=9)
        for axes in pair:
            axes.set_xlabel("x [mm]")
        pair[0].set_ylabel("y [mm]")
        figure.colorbar(shown, ax=list(pair), shrink=0.85, extend="max", label="pressure [MPa]")
        images.append(image_of(figure))
    return images


def traction_of(touch: Touched) -> tuple[FloatArray, FloatArray]:
    """Places (2, n) [mm] and forces (3, n) [N] of the fits of a touch, by their weights."""
    places, forces = [np.zeros((2, 0))], [np.zeros((3, 0))]
    costs = np.array([fit.cost for fit in touch.fits])
    weights = np.exp((costs.min(initial=np.inf) - costs) / TEMPER)
    for weight, fit in zip(weights / weights.sum(), touch.fits, strict=True):
        for part, q in zip(fit.parts, fit.q, strict=True):
            place, force = part.changed(q[None])
            places.append(place[0])
            forces.append(weight * force[0])
    return np.hstack(places), np.hstack(forces)


def _read(decoder: TouchDecoder, contact: Contact, seed: int) -> FloatArray:
    return decoder.errors.read(samples_of([contact]).resistance_ohm, np.random.default_rng(seed))


def _draw_pair(pair: Any, contact: Contact, touch: Touched) -> Any:
    """The contact's traction and the decoded one, each under its net normal force, the latter with what it misses."""
    x, y = np.meshgrid(contact.patch.x_mm, contact.patch.y_mm)
    true = np.stack([x.ravel(), y.ravel()]), contact.cell_force_n.reshape(3, -1)
    net = touch.force_n[:, 2].sum()
    deviation = np.linalg.norm(touch.factors[2::5].sum(axis=0))
    shown, pressure = _draw(pair[0], contact.design, *true)
    pair[0].set_title(f"true: {contact.net_force_n[2]:.0f} N", fontsize=11)
    _, found = _draw(pair[1], contact.design, *traction_of(touch))
    missed = np.abs(found - pressure).sum() / pressure.sum() / 2
    pair[1].set_title(f"decoded: {net:.0f} ± {deviation:.0f} N,\n{missed:.0%} misplaced", fontsize=11)
    return shown


def _draw(axes: Axes, design: SensorDesign, place_mm: FloatArray, force_n: FloatArray) -> tuple[Any, FloatArray]:
    """Pressure in colour, which is returned [MPa], shear as arrows, lines between units."""
    wide, deep = np.array(design.slab_mm[:2]) / 2
    pressure = _density(design, place_mm, force_n, CELL_MM)[2]
    box = (-wide, wide, -deep, deep)
    shown = axes.imshow(pressure, origin="lower", extent=box, vmin=0.0, vmax=TOP_MPA, cmap="magma")
    sx, sy, _ = _density(design, place_mm, force_n, ARROWS_MM)
    x, y = (-side + ARROWS_MM * (np.arange(n) + 0.5) for side, n in ((wide, sx.shape[1]), (deep, sx.shape[0])))
    sx[np.hypot(sx, sy) < SMALLEST_MPA] = np.nan
    axes.quiver(x, y, sx, sy, color="#56b4e9", angles="xy", scale_units="xy", scale=MPA_PER_MM, width=0.008)
    axes.set(xlim=(-wide, wide), ylim=(-deep, deep))
    for axis, side in ((axes.xaxis, wide), (axes.yaxis, deep)):
        axis.set_ticks([-side * 2 / 3, 0.0, side * 2 / 3])
        axis.set_ticks(np.arange(-side, side + 1, design.array.pitch_mm), minor=True)
    axes.grid(color="white", alpha=0.3, linewidth=0.5, which="both")
    axes.tick_params(length=0, which="both", labelsize=8)
    return shown, pressure


def _density(design: SensorDesign, place_mm: FloatArray, force_n: FloatArray, cell_mm: float) -> FloatArray:
    """Traction (3, ny, nx) [MPa] of forces at places, blurred alike whether true or decoded."""
    x_edges, y_edges = (np.arange(-side / 2, side / 2 + cell_mm / 2, cell_mm) for side in design.slab_mm[:2])
    each = [np.histogram2d(place_mm[1], place_mm[0], (y_edges, x_edges), weights=part)[0] for part in force_n]
    return np.stack([gaussian_filter(part, BLUR_MM / cell_mm) for part in each]) / cell_mm**2


def _save(images: list[Image.Image], path: Path) -> None:
    more: dict[str, Any] = {"save_all": True, "append_images": images[1:], "duration": FRAME_MS, "loop": 0}
    with replacing(path) as temporary:
        images[0].save(temporary, "WEBP", quality=QUALITY, method=6, **(more if images[1:] else {}))
