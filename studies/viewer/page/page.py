"""The page at work: what its controls say goes to the scene and to the numbers beside it."""

import asyncio
import time
from typing import Any

import numpy as np

from dataset.resistance import rest_resistances
from dataset.simulate import forces
from fem.array_field import ArrayField
from geometry.design import SensorDesign
from geometry.errors import TriPillarError
from geometry.layout import AXES, PILLARS, FloatArray
from studies.viewer.page import numbers
from studies.viewer.page.feed import SensorFeed, SensorScan
from studies.viewer.page.loads import MOST_PRESSURE_MPA, Indenter, PadLoad
from studies.viewer.page.pictures import Pictures
from studies.viewer.page.scene import ArrayScene, Shown
from studies.viewer.page.sensing import ForceSource, Reading, SensorModel, by_unit, tractions

CAP = 0.3  #: largest pillar strain of the datasets and of the paper
POLL_S = 0.05  #: between two looks at a sensor
LEAST = {"resistance": 2.0, "force": 10.0}  #: % and N that a map draws full at least

#: what controls say before anyone has touched them
CONTROLS: dict[str, Any] = {
    "source": "pads",  # of the loads: pads, indenter, sensor
    "pad": 0,
    "pressure": 0.0,
    "shear": 0.0,
    "angle": 0.0,
    "cone": True,  # whether shear is held within friction
    "peak": 3.0,
    "at_x": 0.0,
    "at_y": 0.0,
    "width": 15.0,
    "drag": 0.0,
    "drag_angle": 0.0,
    "colour": "displacement",
    "scale": 1.0,
    "noise": 0.0,  # of readings, relative
    "dark": False,
    "tab": "maps",  # of the numbers: maps, table
}


class Page:
    """State of the page, and what follows from it.

    Parameters
    ----------
    state
        Of the trame server; its controls are read, the rest is written.
    field, sensor, source
        The displacement field, the resistances and the decoupler.
    feed : SensorFeed, optional
        A sensor that can load the array in place of the controls.
    """

    def __init__(
        self, state: Any, field: ArrayField, sensor: SensorModel, source: ForceSource, feed: SensorFeed | None
    ) -> None:
        self.state, self.feed = state, feed
        self._sensor, self._source = sensor, source
        self._design: SensorDesign = field.design
        self._rest_ohm = rest_resistances(self._design)
        self._traction = np.zeros((self._design.n_units, 3))
        self._scan: SensorScan | None = None
        self._edited: tuple[str, int] | None = None  # source and pad that the sliders stand for
        self._generator = np.random.default_rng(0)
        self._is_changed = asyncio.Event()
        self.scene = ArrayScene(field)
        self.pictures = Pictures(self.scene.plotter, self.scene.fit)
        middle = self._design.array.rows // 2 * self._design.array.cols + self._design.array.cols // 2
        own = {"pad": middle, "width": self._design.array.pitch_mm, "source": "sensor" if feed else "pads"}
        state.update(CONTROLS | own)
        state.rows = []
        state.change(*CONTROLS)(self._on_change)
        self.update()

    async def run(self) -> None:
        """Follow controls and sensor, and draw, until cancelled or something fails."""
        followed = [] if self.feed is None else [self._follow_sensor(self.feed)]
        await asyncio.gather(self.pictures.run(), self._follow_controls(), *followed)

    def reset(self) -> None:
        """Take all loads off."""
        self._traction[:] = 0.0
        self._edited = None
        self.state.update({name: CONTROLS[name] for name in ("shear", "angle", "at_x", "at_y", "drag", "drag_angle")})
        self.state.pressure = self.state.peak = 0.0
        self._is_changed.set()

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first."""
        self.scene.look_from_the_start()
        self.pictures.schedule_render()

    def play_again(self) -> None:
        """Start a recording from its beginning."""
        if self.feed is not None:
            self.feed.play_again()

    def _on_change(self, **_: Any) -> None:
        self._is_changed.set()

    async def _follow_controls(self) -> None:
        while True:
            await self._is_changed.wait()
            self._is_changed.clear()
            with self.state:
                try:
                    self.update()
                    self.state.trouble = ""
                except TriPillarError as error:
                    self.state.trouble = str(error)

    async def _follow_sensor(self, feed: SensorFeed) -> None:
        while True:
            with self.state:
                try:
                    scan = feed.newest()
                except TriPillarError as error:  # of one scan; the next may be sound
                    self.state.trouble = str(error)
                    scan = None
                self.state.link, self.state.ended = feed.status, feed.ended
            if scan is not None:
                self._scan = scan
                self._is_changed.set()
            await asyncio.sleep(POLL_S)

    def update(self) -> None:
        """Bring numbers and scene to what controls and sensor say; the picture is drawn soon after.

        Raises
        ------
        TriPillarError
            If a control is out of bounds, or forces or displacements cannot be told.
        """
        start = time.perf_counter()
        reading = self._loaded()
        change = reading.resistance_ohm / self._rest_ohm - 1.0
        shown = Shown(
            colour=self.state.colour, scale=float(self.state.scale), chosen=self.state.pad, dark=self.state.dark
        )
        legend = self.scene.show(self._traction, change.reshape(-1, 3), shown)
        seconds = time.perf_counter() - start
        self._tell(reading, change)
        self.state.legend = {
            "title": legend.title,
            "low": numbers.short(legend.low),
            "high": numbers.short(legend.high),
            "colours": f"linear-gradient(to right, {', '.join(legend.colours)})",
        }
        self.state.compute_ms, self.state.draw_ms = f"{1e3 * seconds:.0f}", f"{self.pictures.draw_ms:.0f}"
        self.pictures.schedule_render()

    def _loaded(self) -> Reading:
        """Load the array as the controls or the sensor say, and read it."""
        state = self.state
        if state.source == "sensor" and self._scan is not None:
            scan = self._scan
            self._traction = tractions(scan.force_n, self._design)
            _, strain = self._sensor.strains(self._traction)
            return Reading(resistance_ohm=scan.resistance_ohm, force_n=scan.force_n, strain=strain)
        if state.source == "indenter":
            load = self._held(state.peak, state.drag, state.drag_angle)
            indenter = Indenter(load=load, x_mm=float(state.at_x), y_mm=float(state.at_y), width_mm=float(state.width))
            self._traction = indenter.tractions(self._design)
        elif state.source == "pads" and self._edited == (state.source, state.pad):
            self._traction[state.pad] = self._held(state.pressure, state.shear, state.angle).traction_mpa
        elif state.source == "pads":  # another pad was chosen: the sliders are to show its load
            load = PadLoad.of(self._traction[state.pad])
            state.pressure, state.shear = round(load.pressure_mpa, 2), round(load.shear_mpa, 2)
            state.angle = round(load.angle_deg)
        self._edited = (state.source, state.pad)
        return self._sensor.read(self._traction, self._source, float(state.noise), self._generator)

    def _held(self, pressure: float, shear: float, angle: float) -> PadLoad:
        """What three sliders say, within friction if that is asked for."""
        load = PadLoad(pressure_mpa=float(pressure), shear_mpa=float(shear), angle_deg=float(angle))
        return load.within_cone() if self.state.cone else load

    def _tell(self, reading: Reading, change: FloatArray) -> None:
        """Write the numbers beside the picture."""
        state, design = self.state, self._design
        cols = design.array.cols
        is_applied = state.source != "sensor"
        applied_n = by_unit(forces(self._traction, design), design)
        if not is_applied:
            applied_n = np.full_like(applied_n, np.nan)  # a sensor does not say what acts on it
        row, col = divmod(state.pad, cols)
        state.pads = numbers.pad_cells(self._traction, cols, MOST_PRESSURE_MPA)
        if state.tab == "table":
            state.rows = numbers.table_rows(reading.resistance_ohm, applied_n, reading.force_n, cols)
        else:
            state.resistance_maps = [
                numbers.as_map(f"{name} pillar", "%", 100.0 * change[..., k], LEAST["resistance"])
                for k, name in enumerate(PILLARS)
            ]
            state.force_maps = [
                numbers.as_map(f"F{name}", "N", reading.force_n[..., k], LEAST["force"], digits=0)
                for k, name in enumerate(AXES)
            ]
        shown = (reading.resistance_ohm, change, reading.strain, applied_n, reading.force_n)
        unit = numbers.unit_rows(*(values[row, col] for values in shown))
        state.unit_pillars, state.unit_forces = unit["pillars"], unit["forces"]
        state.unit_name = f"row {row}, col {col}"
        worst = np.unravel_index(int(reading.strain.argmax()), reading.strain.shape)
        strain = float(reading.strain[worst])
        state.strain = numbers.text(100.0 * strain, 1)
        state.strain_share = min(strain / CAP, 1.0) * 100.0
        state.strain_over = strain > CAP
        state.strain_at = f"{PILLARS[worst[2]]} pillar of row {worst[0]}, col {worst[1]}"
        missed = reading.force_n - applied_n
        known = missed[np.isfinite(missed)]
        state.rms = numbers.text(float(np.sqrt(np.mean(known**2))), 2) if known.size else ""
