"""The sensor under a gripper's finger in MuJoCo: press, slide, lift; decoded forces beside MuJoCo's own.

``python examples/mujoco_press.py`` needs ``pip install 'tripillar[simulators]'``. ``--picture FILE.png`` draws what
happens (matplotlib), ``--film FILE.mp4`` films it (the extra ``film``, too); neither needs a display.
"""

import argparse
import ctypes.util
import os
import sys
import time
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

if find_spec("mujoco") is None:
    sys.exit("mujoco is not installed: pip install 'tripillar[simulators]'.")
if sys.platform == "linux" and not os.environ.get("DISPLAY") and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # lets MuJoCo draw without a display; before its import

import numpy as np
import torch
from finger_on_slab import FINGERTIP, DrawingError, finger_on_slab, pad_stiffness, renderer

import tripillar as tp
from common.storage.files import replacing
from geometry.layout import unit_centres
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Crossbar
from tripillar.simulators.contacts import ContactReader, stacked

NOISE, BITS, SENSE_OHM = 0.001, 12, 3300.0  # noise of a resistance, relative; the crossbar's converter and resistors
SCAN_S = 0.005  # from scan to scan
#: time [s] and where the finger is told to be [mm]: x, y, and z from where it begins, 4 mm above the slab
PATH = np.array(
    [(0, -4, -4, 0), (0.8, -4, -4, -4), (1.8, -4, -4, -9), (2.3, -4, -4, -9), (4.3, 4, -4, -9), (6.3, 4, 4, -9),
     (7.3, 4, 4, -6), (8, 4, 4, 0)]
)  # fmt: skip
TOUCH_N = 1.0  # normal force from which errors count
PICTURE_S, FILM_HZ = 3.8, 25  # moment of the picture's upper left; pictures a second
MOST_N = 17.0  # of the axes
ARROW_MM_PER_N = 3.0  # of forces in the scene
KEY_N = 2.0  # shear of the arrow that explains the others


class Scan(NamedTuple):
    """One scan; forces on the sensor, Fz positive in compression."""

    time_s: float
    decoded_n: np.ndarray  # (rows, cols, 3)
    applied_n: np.ndarray  # (3,): net, of MuJoCo's contacts
    centre_mm: np.ndarray  # (2,): of pressure, of MuJoCo's contacts; NaN without
    strain: float  # the largest of a pillar

    @property
    def net_n(self):
        return self.decoded_n.sum(axis=(0, 1))


def trained(response, samples=2000):
    """A decoder for fingers, from exact samples of 0 to 10 N on up to three pads, and shear of up to 0.7 of that."""
    light = tp.dataset(response, "light", samples, seed=1)
    force_n = light.force_n * (3.5, 3.5, 1.0)  # the protocol's friction is up to 0.2
    sensor = tp.VirtualSensor(response.design, environments=len(light), response=response)
    resistance_ohm = sensor.resistances(torch.from_numpy(force_n)).numpy()
    samples = tp.Samples(force_n=force_n, resistance_ohm=resistance_ohm, design=response.design)
    return tp.train(samples, response=response)


def press(response, model, seed=0, seconds=PATH[-1, 0]):
    """Let the finger press, slide and lift; yield MuJoCo's model and data with each scan."""
    import mujoco

    design = response.design
    world = finger_on_slab(design, pad_stiffness(response))
    data = mujoco.MjData(world)
    contacts = ContactReader(world, site="sensor", geom="slab")
    rows, cols = design.array.rows, design.array.cols
    crossbar = Crossbar.suited(ScanMode.ZERO_POTENTIAL, rows=rows, cols=cols, bits=BITS, sense_ohm=SENSE_OHM)
    sensor = tp.VirtualSensor(design, model, noise=NOISE, crossbar=crossbar, seed=seed, response=response)
    data.qpos[:] = data.ctrl[:] = PATH[0, 1:] / 1000.0
    for _ in range(round(seconds / SCAN_S)):
        data.ctrl[:] = [np.interp(data.time + SCAN_S, PATH[:, 0], to) / 1000.0 for to in PATH[:, 1:].T]
        mujoco.mj_step(world, data, nstep=round(SCAN_S / world.opt.timestep))
        found = contacts.read(data)
        with torch.no_grad():
            reading = sensor.touch(*map(torch.from_numpy, stacked([found])))
            strain = sensor.strains(reading.force_n).item()
        yield world, data, Scan(data.time, reading.decoded_n[0].numpy(), found.net_n, found.centre_mm, strain)


def errors(scans, design):
    """Root mean squares of what the decoder gets wrong while the finger touches."""
    touching = [scan for scan in scans if scan.applied_n[2] >= TOUCH_N]
    off = np.array([scan.net_n - scan.applied_n for scan in touching])
    pressed = np.array([scan.applied_n[2] for scan in touching])
    fz = np.array([scan.decoded_n[..., 2].reshape(-1) for scan in touching])
    centre = fz @ unit_centres(design) / fz.sum(axis=1, keepdims=True) - [scan.centre_mm for scan in touching]
    return {
        "normal_n": np.sqrt((off[:, 2] ** 2).mean()),
        "normal_share": np.sqrt((off[:, 2] ** 2).mean() / (pressed**2).mean()),
        "shear_n": np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()),
        "centre_mm": np.sqrt((centre**2).sum(axis=1).mean()),
    }


class Drawing:
    """The scene with an arrow a pad, the pads from above, and net forces over time."""

    def __init__(self, design):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.design, self._renderer = design, None
        self.figure = Figure(figsize=(12.8, 7.2), dpi=100)
        FigureCanvasAgg(self.figure)
        self._scene = self.figure.add_axes((0.01, 0.44, 0.47, 0.55))
        self._scene.set_axis_off()
        pads, bar = self.figure.add_axes((0.08, 0.08, 0.26, 0.29)), self.figure.add_axes((0.36, 0.08, 0.012, 0.29))
        x, y = unit_centres(design).T
        half = design.array.pitch_mm / 2
        self._fz = pads.imshow(
            np.zeros((design.array.rows, design.array.cols)), cmap="Oranges", vmin=0, vmax=MOST_N / 2, origin="lower",
            extent=(x.min() - half, x.max() + half, y.min() - half, y.max() + half),
        )  # fmt: skip
        self._shear = pads.quiver(
            x, y, 0 * x, 0 * y, angles="xy", scale_units="xy", scale=MOST_N / 4 / design.array.pitch_mm, width=0.012,
            color="#1f5fa8",
        )  # fmt: skip
        self._centre = pads.plot([], [], "k+", markersize=14, markeredgewidth=2)[0]
        pads.set(xlabel="x [mm]", ylabel="y [mm]", title="decoded pads; + MuJoCo's centre of pressure")
        pads.quiverkey(self._shear, 0.03, 0.03, KEY_N, f"shear of {KEY_N:g} N", labelpos="E", coordinates="figure")
        self.figure.colorbar(self._fz, cax=bar, label="Fz of a pad [N]")
        side_n = design.slab_mm[0] / ARROW_MM_PER_N
        self.figure.text(0.05, 0.975, f"red: decoded force on a pad; as long as the sensor: {side_n:.2g} N", va="top")
        forces, misses = self.figure.add_axes((0.55, 0.36, 0.43, 0.61)), self.figure.add_axes((0.55, 0.08, 0.43, 0.22))
        self._curves = []
        for axis, colour in zip("xyz", ("#1f5fa8", "#3a9a5b", "#d9701f"), strict=True):
            decoded = forces.plot([], [], color=colour, linewidth=1.0, label=f"F{axis} decoded")[0]
            applied = forces.plot([], [], "k--", linewidth=1.0, label="MuJoCo" if axis == "z" else None)[0]
            self._curves.append((decoded, applied, misses.plot([], [], color=colour, linewidth=0.6)[0]))
        self._moment = forces.axvline(0.0, color="0.6", linewidth=0.8)
        misses.axhline(0.0, color="k", linewidth=0.5)
        forces.set(xlim=(0, PATH[-1, 0]), ylim=(-1, 1.3 * MOST_N), ylabel="net force on the sensor [N]")
        forces.legend(loc="upper left", frameon=False, ncols=4, fontsize=9)
        misses.set(xlim=(0, PATH[-1, 0]), ylim=(-1, 1), xlabel="time [s]", ylabel="decoded − MuJoCo [N]")

    def show(self, world, data, scan):
        """Draw one scan."""
        self._fz.set_data(scan.decoded_n[..., 2])
        self._shear.set_UVC(scan.decoded_n[..., 0], scan.decoded_n[..., 1])
        self._centre.set_data(scan.centre_mm[:1], scan.centre_mm[1:])
        self._moment.set_xdata([scan.time_s])
        picture = self._picture(world, data, scan)
        if picture is not None:
            self._scene.images[0].set_data(picture) if self._scene.images else self._scene.imshow(picture)

    def show_curves(self, scans):
        """Draw net forces over time."""
        time_s = np.array([scan.time_s for scan in scans])
        found, applied = np.array([scan.net_n for scan in scans]), np.array([scan.applied_n for scan in scans])
        for axis, lines in enumerate(self._curves):
            for line, values in zip(lines, (found, applied, found - applied), strict=True):
                line.set_data(time_s, values[:, axis])

    def pixels(self):
        """The whole, (720, 1280, 3) of 0 to 255."""
        self.figure.canvas.draw()
        return np.asarray(self.figure.canvas.buffer_rgba())[..., :3]

    def _picture(self, world, data, scan):
        """The scene as MuJoCo draws it; None where it cannot, which is said once."""
        import mujoco

        if self._renderer is None:
            try:
                self._renderer = renderer(world, 960, 720)
            except DrawingError as error:
                print(f"pictures without the scene: {error}", file=sys.stderr)
                self._renderer = False
        if not self._renderer:
            return None
        self._renderer.update_scene(data)
        scene, arrow = self._renderer.scene, mujoco.mjtGeom.mjGEOM_ARROW
        for (x, y), force_n in zip(unit_centres(self.design), scan.decoded_n.reshape(-1, 3), strict=True):
            if np.linalg.norm(force_n) > 0.3:
                head = np.array([x, y, self.design.unit.height_mm]) / 1000.0
                tail = head - ARROW_MM_PER_N / 1000.0 * force_n * (1, 1, -1)
                red = np.array([0.85, 0.1, 0.1, 1.0], dtype=np.float32)
                mujoco.mjv_initGeom(scene.geoms[scene.ngeom], arrow, np.zeros(3), np.zeros(3), np.zeros(9), red)
                beyond = 2.0 * head - tail  # MuJoCo draws half of an arrow
                mujoco.mjv_connector(scene.geoms[scene.ngeom], arrow, 0.0005, tail, beyond)
                scene.ngeom += 1
        return self._renderer.render()


def main(picture=None, film=None):
    """Press, draw if a file is named, and print the errors."""
    packages = ["matplotlib"] * bool(picture or film) + ["imageio", "imageio_ffmpeg"] * bool(film)
    if absent := [name for name in packages if find_spec(name) is None]:
        sys.exit(f"{', '.join(absent)} not installed: pip install matplotlib 'tripillar[film]'.")
    response = tp.response(FINGERTIP)
    model = trained(response)
    scans, seconds = [], 0.0
    drawn, filmed = Drawing(FINGERTIP) if picture else None, Drawing(FINGERTIP) if film else None
    with ExitStack() as files:
        if film:
            import imageio

            made = files.enter_context(replacing(film))
            frames = files.enter_context(imageio.get_writer(made, fps=FILM_HZ, quality=8))
        pressing = press(response, model)
        while True:
            begun = time.perf_counter()
            world, data, scan = next(pressing, (None, None, None))
            seconds += time.perf_counter() - begun
            if scan is None:
                break
            scans.append(scan)
            if drawn and len(scans) == round(PICTURE_S / SCAN_S):
                drawn.show(world, data, scan)
            if filmed and len(scans) % round(1 / (FILM_HZ * SCAN_S)) == 0:
                filmed.show(world, data, scan)
                filmed.show_curves(scans)
                frames.append_data(filmed.pixels())
    if drawn:
        drawn.show_curves(scans)
        with replacing(picture) as made:
            drawn.figure.savefig(made)
    found, most_n = errors(scans, FINGERTIP), np.max([scan.applied_n for scan in scans], axis=0)
    strain = max(scan.strain for scan in scans)
    print(f"pressed with {most_n[2]:.1f} N, dragged with {max(most_n[:2]):.1f} N, pillars strained by {strain:.2f}")
    print(f"net normal force: error {found['normal_n']:.2f} N, {found['normal_share']:.1%} of MuJoCo's")
    print(f"net shear: error {found['shear_n']:.3f} N; centre of pressure: {found['centre_mm']:.2f} mm")
    print(f"{len(scans)} scans in {seconds:.1f} s, simulation included: {len(scans) / seconds:.0f} a second")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--picture", type=Path, help="PNG to write")
    arguments.add_argument("--film", type=Path, help="MP4 to write")
    main(**vars(arguments.parse_args()))
