"""The page of one browser at work: what its controls say goes to the scene and to the numbers beside it."""

import asyncio
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from dataset.protocols import FRICTION
from dataset.resistance import rest_resistances
from dataset.simulation import forces
from geometry.design import SensorDesign
from geometry.errors import TriPillarError
from geometry.layout import AXES, PILLARS, FloatArray
from tripillar.viewer.page import numbers
from tripillar.viewer.page.controls import ControlError, Range, controls_of, mapping, numbers_of, shortened, taken
from tripillar.viewer.page.exports import csv_of, scene_of
from tripillar.viewer.page.feed import SensorWatch
from tripillar.viewer.page.loads import MAX_PRESSURE_MPA, MAX_SHEAR_MPA, Indenter, PadLoad
from tripillar.viewer.page.pictures import Pictures
from tripillar.viewer.page.scene import PADS_BAR, ArrayScene, Shown
from tripillar.viewer.page.sensing import ForceSource, Reading, SensorModel, by_unit, tractions
from tripillar.viewer.page.superposition import Superposition

CAP = 0.3  #: largest pillar strain of the datasets and of the paper
LEAST = {"resistance": 2.0, "force": 10.0}  #: % and N that a map draws full at least
LOAD_SLIDERS = "pressure", "shear", "angle"  #: of the chosen pad
LIMITS_MPA = np.array([MAX_SHEAR_MPA, MAX_SHEAR_MPA, MAX_PRESSURE_MPA])  #: of a pad's traction that is put back


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """What all browsers look at; none changes it."""

    loads: Superposition
    sensor: SensorModel
    source: ForceSource
    watch: SensorWatch | None = None  #: of a sensor that can load the array in place of the controls

    @property
    def design(self) -> SensorDesign:
        return self.loads.field.design


class Page:
    """State of one browser's page, and what follows from it.

    Parameters
    ----------
    subject : Subject
        The array that the page shows.
    """

    def __init__(self, subject: Subject) -> None:
        self._subject, self._design = subject, subject.design
        self._rest_ohm = rest_resistances(self._design)
        self._traction = np.zeros((self._design.n_units, 3))
        self._reading: Reading | None = None  # as it is shown
        self._generator = np.random.default_rng(0)
        self._kinds = controls_of(self._design, subject.watch is not None)
        self.controls: dict[str, Any] = {name: kind.start for name, kind in self._kinds.items()}
        self.is_changed = asyncio.Event()
        self.is_changed.set()
        self.scene = ArrayScene(subject.loads)
        self.pictures = Pictures(self.scene.plotter, self.scene.fit)
        if subject.watch is not None:
            subject.watch.listeners.add(self.hear)

    def close(self) -> None:
        """Let go of the scene and of the sensor."""
        if self._subject.watch is not None:
            self._subject.watch.listeners.discard(self.hear)
        self.scene.plotter.close()

    def facts(self) -> dict[str, Any]:
        """What does not change: the array, and what each control may say."""
        array, watch = self._design.array, self._subject.watch
        kinds = {
            name: {"least": kind.least, "most": kind.most, "step": kind.step}
            if isinstance(kind, Range)
            else {"among": kind.among, "titles": kind.titles}
            for name, kind in self._kinds.items()
        }
        return {
            "rows": array.rows,
            "cols": array.cols,
            "pitch_mm": array.pitch_mm,
            "cap": 100 * CAP,
            "friction": FRICTION,
            "decoupler": self._subject.source.name,
            "sensor": None if watch is None else watch.feed.port,
            "kinds": kinds,
        }

    # what a browser can say

    def set(self, said: object) -> None:
        """Take values of controls, {name: value}.

        Raises
        ------
        ControlError
            If one is not sound; then none is taken.
        """
        given = taken(self._kinds, said)
        self.controls |= given
        if self.controls["source"] == "pads":
            if given.keys() & {*LOAD_SLIDERS, "cone"}:
                self._traction[self.controls["pad"]] = self._held(*LOAD_SLIDERS).traction_mpa
            elif given.keys() & {"pad", "source"}:
                self._show_load_of_pad()
        self.is_changed.set()

    def restore(self, said: object) -> None:
        """Take what `update` gave as "state": all controls, and the pads' tractions.

        Raises
        ------
        ControlError
            If something in it is not sound; then nothing is taken.
        """
        state = mapping("a state", said)
        if state.keys() != {"controls", "traction_mpa"}:
            raise ControlError(f"a state has 'controls' and 'traction_mpa', not {shortened(list(state))}.")
        given, n = taken(self._kinds, state["controls"]), 3 * self._design.n_units
        traction = np.array(numbers_of("traction_mpa", state["traction_mpa"], n, -1e3, 1e3)).reshape(-1, 3)
        self._traction = np.clip(traction, -LIMITS_MPA, LIMITS_MPA * (1, 1, 0))
        self.controls |= given
        self.is_changed.set()

    def reset(self) -> None:
        """Take all loads off."""
        self._traction[:] = 0.0
        names = (*LOAD_SLIDERS, "peak", "at_x", "at_y", "drag", "drag_angle")
        self.controls |= dict.fromkeys(names, 0.0)
        self.is_changed.set()

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first."""
        self.scene.look_from_the_start()
        self.pictures.schedule_render()

    def play_again(self) -> None:
        """Start a recording from its beginning, for all who look."""
        if self._subject.watch is not None:
            self._subject.watch.play_again()

    def hear(self) -> None:
        """The sensor has said something."""
        if self.controls["source"] == "sensor":
            self.is_changed.set()

    def file(self, kind: object) -> dict[str, str]:
        """What is shown as a file: its "name" and "text".

        Raises
        ------
        ControlError
            If there is no file of that kind, or nothing is shown yet.
        """
        if self._reading is None or kind not in ("csv", "scene"):
            raise ControlError(f"there is no file {shortened(kind)}.")
        if kind == "scene":
            return {"name": "scene.toml", "text": scene_of(self._design, self._traction, self.controls["pad"])}
        reading = self._reading
        text = csv_of(self._design, self._traction, reading.resistance_ohm, self._applied_n(), reading.force_n)
        return {"name": "tripillar.csv", "text": text}

    # what follows from it

    def update(self) -> dict[str, Any]:
        """Bring the scene to what controls and sensor say, and have it drawn soon.

        Returns
        -------
        dict
            What the page shows beside the picture. "trouble" alone where forces or displacements cannot be told.
        """
        start = time.perf_counter()
        try:
            reading = self._reading = self._loaded()
        except TriPillarError as error:
            return {"trouble": str(error)}
        change = reading.resistance_ohm / self._rest_ohm - 1.0
        controls = self.controls
        shown = Shown(colour=controls["colour"], scale=controls["scale"], chosen=controls["pad"], dark=controls["dark"])
        legend = self.scene.show(self._traction, change.reshape(-1, 3), shown)
        seconds = time.perf_counter() - start
        self.pictures.schedule_render()
        watch = self._subject.watch
        heard = {} if watch is None else {"link": watch.link, "ended": watch.ended}
        return self._numbers(reading, change) | heard | {
            "trouble": "" if watch is None else watch.trouble,
            "legend": [numbers.legend(bar) for bar in (legend, PADS_BAR)],
            "scale_note": "true scale" if controls["scale"] == 1 else f"displacement × {controls['scale']}",
            "times": f"computed in {1e3 * seconds:.0f} ms, drawn in {self.pictures.draw_ms:.0f} ms",
            "state": {"controls": dict(controls), "traction_mpa": self._traction.ravel().round(4).tolist()},
        }  # fmt: skip

    def _loaded(self) -> Reading:
        """Load the array as the controls or the sensor say, and read it."""
        controls, sensor, watch = self.controls, self._subject.sensor, self._subject.watch
        if controls["source"] == "sensor" and watch is not None and watch.scan is not None:
            scan = watch.scan
            self._traction = tractions(scan.force_n, self._design)
            _, strain = sensor.strains(self._traction)
            return Reading(resistance_ohm=scan.resistance_ohm, force_n=scan.force_n, strain=strain)
        if controls["source"] == "indenter":
            load = self._held("peak", "drag", "drag_angle")
            indenter = Indenter(load=load, x_mm=controls["at_x"], y_mm=controls["at_y"], width_mm=controls["width"])
            self._traction = indenter.tractions(self._design)
        return sensor.read(self._traction, self._subject.source, controls["noise"], self._generator)

    def _held(self, pressure: str, shear: str, angle: str) -> PadLoad:
        """What three sliders say, within friction if that is asked for."""
        said = self.controls
        load = PadLoad(pressure_mpa=said[pressure], shear_mpa=said[shear], angle_deg=said[angle])
        return load.within_cone() if said["cone"] else load

    def _show_load_of_pad(self) -> None:
        """Another pad was chosen: the sliders are to show its load."""
        load = PadLoad.of(self._traction[self.controls["pad"]])
        values = round(load.pressure_mpa, 2), round(load.shear_mpa, 2), float(round(load.angle_deg))
        self.controls |= dict(zip(LOAD_SLIDERS, values, strict=True))

    def _applied_n(self) -> FloatArray:
        """Forces on the pads, (rows, cols, 3) [N]; NaN where a sensor does not say what acts on it."""
        applied_n = by_unit(forces(self._traction, self._design), self._design)
        return np.full_like(applied_n, np.nan) if self.controls["source"] == "sensor" else applied_n

    def _numbers(self, reading: Reading, change: FloatArray) -> dict[str, Any]:
        """The numbers beside the picture."""
        controls, design = self.controls, self._design
        cols = design.array.cols
        applied_n = self._applied_n()
        row, col = divmod(controls["pad"], cols)
        if controls["tab"] == "table":
            beside: dict[str, Any] = {
                "rows": numbers.table_rows(reading.resistance_ohm, applied_n, reading.force_n, cols)
            }
        elif controls["tab"] == "time":
            beside = {"sample": numbers.sample(change, reading.force_n)}
        else:
            maps = [
                numbers.as_map(f"{name} pillar", "%", 100.0 * change[..., k], LEAST["resistance"])
                for k, name in enumerate(PILLARS)
            ]
            force_maps = [
                numbers.as_map(f"F{name}", "N", reading.force_n[..., k], LEAST["force"], digits=0)
                for k, name in enumerate(AXES)
            ]
            beside = {"resistance_maps": maps, "force_maps": force_maps}
        shown = (reading.resistance_ohm, change, reading.strain, applied_n, reading.force_n)
        unit = numbers.unit_rows(*(values[row, col] for values in shown))
        worst = np.unravel_index(int(reading.strain.argmax()), reading.strain.shape)
        strain = float(reading.strain[worst])
        missed = reading.force_n - applied_n
        known = missed[np.isfinite(missed)]
        return beside | {
            "pads": numbers.pad_cells(self._traction, cols, MAX_PRESSURE_MPA),
            "unit_pillars": unit["pillars"],
            "unit_forces": unit["forces"],
            "unit_name": f"row {row}, col {col}",
            "strain": numbers.text(100.0 * strain, 1),
            "strain_share": min(strain / CAP, 1.0) * 100.0,
            "strain_over": strain > CAP,
            "strain_at": f"{PILLARS[worst[2]]} pillar of row {worst[0]}, col {worst[1]}",
            "rms": numbers.text(float(np.sqrt(np.mean(known**2))), 2) if known.size else "",
        }
