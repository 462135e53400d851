"""The page of one browser: its controls or a sensor load the array; a picture and numbers follow."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from dataset.protocols import FRICTION
from fem.pictures.arrays import indenter_tractions
from geometry.design import SensorDesign
from geometry.errors import TriPillarError
from geometry.layout import FloatArray
from tripillar.viewer.page import numbers
from tripillar.viewer.page.controls import (
    MAX_PRESSURE_MPA,
    MAX_SHEAR_MPA,
    ControlError,
    controls_of,
    mapping,
    numbers_of,
    shortened,
    sliders_of,
    taken,
    traction_of,
)
from tripillar.viewer.page.finite import REST_S, FiniteAnswer, FiniteStrain, is_answer_to
from tripillar.viewer.page.pictures import Pictures
from tripillar.viewer.page.scene import ArrayScene, Superposition
from tripillar.viewer.page.sensing import PressedSensor, Reading, SensorFeed
from tripillar.viewer.sights import beyond_linear

LOAD_SLIDERS = "pressure", "shear", "angle"  #: of the chosen pad
MAX_DRAWN = 1.0  #: strain of a pillar that is drawn; forces of a broken sensor would tear the array to pieces
UNDRAWN = "drawn at rest: no pillar bears these forces"
LIMITS_MPA = np.array([MAX_SHEAR_MPA, MAX_SHEAR_MPA, MAX_PRESSURE_MPA])  #: of a pad's traction in a restored state


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """The array that all browsers look at; none changes it."""

    loads: Superposition
    sensor: PressedSensor
    decoupler: str  #: name of what turns resistances into forces
    feed: SensorFeed | None = None  #: of a sensor that can load the array in place of the controls
    finite: FiniteStrain | None = None  #: solves neo-Hookean rubber; `loads` and `sensor` stay linear

    @property
    def design(self) -> SensorDesign:
        """The design of the array."""
        return self.loads.field.design if self.finite is None else self.finite.design


class Page:
    """State of one browser's page, with its scene and its pictures.

    Parameters
    ----------
    subject : Subject
        The array that the page shows.
    """

    def __init__(self, subject: Subject) -> None:
        self._subject, self._design = subject, subject.design
        self._traction = np.zeros((self._design.n_units, 3))
        self._reading: Reading | None = None  # as it is shown
        self._answer: FiniteAnswer | None = None  # of the last load solved at finite strain
        self._generator = np.random.default_rng(0)
        self._kinds = controls_of(self._design, subject.feed is not None)
        self.controls: dict[str, Any] = {name: kind.start for name, kind in self._kinds.items()}
        self.is_changed, self._is_unsolved = asyncio.Event(), asyncio.Event()
        self.is_changed.set()
        self.scene = ArrayScene(subject.loads)
        self.pictures = Pictures(self.scene.plotter, self.scene.fit)
        #: what a browser can have done, without further words
        self.calls: dict[str, Callable[[], None]] = {"reset": self._reset, "home": self._look_from_the_start}
        if subject.feed is not None:
            self.calls["again"] = subject.feed.play_again
            subject.feed.listeners.add(self._hear)

    def close(self) -> None:
        """Let go of the scene and of the sensor."""
        if self._subject.feed is not None:
            self._subject.feed.listeners.discard(self._hear)
        self.scene.plotter.close()

    def facts(self) -> dict[str, Any]:
        """The facts that do not change: the array, and the values that each control may take."""
        array, feed = self._design.array, self._subject.feed
        return {
            "rows": array.rows,
            "cols": array.cols,
            "pitch_mm": array.pitch_mm,
            "pads": self._design.pad.kind,
            "cap": 100 * numbers.CAP,
            "friction": FRICTION,
            "decoupler": self._subject.decoupler,
            "sensor": None if feed is None else feed.port,
            "kinds": {name: asdict(kind) for name, kind in self._kinds.items()},
        }

    # messages of the browser

    def set(self, said: object) -> None:
        """Take values of controls, {name: value}; ControlError, and none is taken, if one is not sound."""
        given = taken(self._kinds, said)
        self.controls |= given
        if self.controls["source"] == "pads":
            if given.keys() & {*LOAD_SLIDERS, "cone"}:
                self._traction[self.controls["pad"]] = self._held(*LOAD_SLIDERS)
            elif given.keys() & {"pad", "source"}:
                self._show_load_of_pad()
        self.is_changed.set()

    def restore(self, said: object) -> None:
        """Take all controls, and the pads' tractions as `update` gave them. Errors as of `set`."""
        state = mapping("a state", said)
        if state.keys() != {"controls", "traction_mpa"}:
            raise ControlError(f"a state has 'controls' and 'traction_mpa', not {shortened(list(state))}.")
        given, n = taken(self._kinds, state["controls"]), 3 * self._design.n_units
        traction = np.array(numbers_of("traction_mpa", state["traction_mpa"], n, -1e3, 1e3)).reshape(-1, 3)
        self._traction = np.clip(traction, -LIMITS_MPA, LIMITS_MPA * (1, 1, 0))
        self.controls |= given
        self.is_changed.set()

    def do(self, said: object) -> None:
        """Do one of `calls`; ControlError if it is none."""
        if not isinstance(said, str) or said not in self.calls:
            raise ControlError(f"do={shortened(said)} is none of {', '.join(self.calls)}.")
        self.calls[said]()

    def file(self, kind: object) -> dict[str, str]:
        """A file of what is shown, "name" and "text"; ControlError if there is none of that kind, or none yet."""
        if self._reading is None or kind not in ("csv", "scene"):
            raise ControlError(f"there is no file {shortened(kind)}.")
        if kind == "scene":
            return {"name": "scene.toml", "text": numbers.scene_of(self._design, self._traction, self.controls["pad"])}
        return {"name": "tripillar.csv", "text": numbers.csv_of(self._design, self._reading)}

    def _reset(self) -> None:
        """Take all loads off."""
        self._traction[:] = 0.0
        self.controls |= dict.fromkeys((*LOAD_SLIDERS, "peak", "at_x", "at_y", "drag", "drag_angle"), 0.0)
        self.is_changed.set()

    def _look_from_the_start(self) -> None:
        """Put the camera where it was at first."""
        self.scene.look_from_the_start()
        self.pictures.schedule_render()

    def _hear(self) -> None:
        """Follow the sensor, which has something new."""
        if self.controls["source"] == "sensor":
            self.is_changed.set()

    async def solve(self) -> None:
        """Solve at finite strain for loads that rest, until cancelled."""
        while True:
            await self._is_unsolved.wait()
            before = self._traction.copy()
            await asyncio.sleep(REST_S)
            self._is_unsolved.clear()
            finite = self._subject.finite
            if finite is None or is_answer_to(self._answer, self._traction):
                continue
            if np.array_equal(before, self._traction):
                self._answer = await finite.answer(before)
            self.is_changed.set()

    # what the browser shows

    def update(self) -> dict[str, Any]:
        """Load the array, schedule its picture, and return what the page shows beside it.

        That is "trouble" alone where forces or displacements are unknown.
        """
        start, controls, feed = time.perf_counter(), self.controls, self._subject.feed
        try:
            answer, reading = self._loaded()
        except TriPillarError as error:
            return {"trouble": str(error)}
        self._reading, self._traction = reading, reading.traction_mpa
        is_drawn = bool(reading.strain.max() <= MAX_DRAWN)
        legend = self.scene.show(
            self._traction if is_drawn else 0.0 * self._traction, reading.change.reshape(-1, 3), controls["colour"],
            controls["scale"], controls["pad"], controls["dark"],
            answer.field if answer is not None and is_drawn else None,
        )  # fmt: skip
        seconds = time.perf_counter() - start
        self.pictures.schedule_render()
        shown = numbers.beside_picture(controls["tab"], controls["pad"], reading) | {
            "trouble": "" if answer is None else answer.refusal,
            "legend": [numbers.legend(bar) for bar in (legend, self.scene.pads_bar)],
            "scale_note": "true scale" if controls["scale"] == 1 else f"displacement × {controls['scale']}",
            "strain_note": self._strain_note(answer, reading) if is_drawn else UNDRAWN,
            "times": f"computed in {1e3 * seconds:.0f} ms, drawn in {self.pictures.draw_ms:.0f} ms",
            "traction_mpa": self._traction.ravel().round(4).tolist(),
        }
        if feed is not None:
            of_scan = {"faults": feed.faults, "contacts": feed.contacts} if controls["source"] == "sensor" else {}
            shown |= {"link": feed.link, "ended": feed.ended, "faults": [], "contacts": []} | of_scan
            shown["trouble"] = feed.trouble or shown["trouble"]
        return shown

    def _strain_note(self, answer: FiniteAnswer | None, reading: Reading) -> str:
        """What the picture and the numbers are worth."""
        largest = float(reading.strain.max())
        beyond = beyond_linear(largest) or "linear"
        if self._subject.finite is None:
            return beyond
        if answer is None:
            return beyond + ("" if self.controls["source"] == "sensor" else "; solving finite strain …")
        if answer.field is None:
            return f"{beyond}; no answer at finite strain"
        return f"finite strain, estimated error {answer.error_estimate:.1%}"

    def _loaded(self) -> tuple[FiniteAnswer | None, Reading]:
        """Load the array as the controls or the sensor say, and read it: at finite strain once that is solved."""
        controls, sensor, feed = self.controls, self._subject.sensor, self._subject.feed
        if controls["source"] == "sensor" and feed is not None and feed.scan is not None:
            return None, sensor.follow(feed.scan)
        if controls["source"] == "indenter":
            at_middle, centre = self._held("peak", "drag", "drag_angle"), (controls["at_x"], controls["at_y"])
            self._traction = indenter_tractions(self._design, at_middle, centre, controls["width"])
        answer = self._answer if is_answer_to(self._answer, self._traction) else None
        if answer is None and self._subject.finite is not None and controls["source"] != "sensor":
            self._is_unsolved.set()
        finite_mm = None if answer is None else answer.moved_mm
        reading = sensor.read(self._traction, controls["noise"], self._generator, finite_mm)
        unknown = np.full_like(reading.applied_n, np.nan)
        return answer, replace(reading, applied_n=unknown) if controls["source"] == "sensor" else reading

    def _held(self, pressure: str, shear: str, angle: str) -> FloatArray:
        """The traction (3,) [MPa] of three sliders, within friction if the page asks for that."""
        pressed, dragged, towards = (self.controls[name] for name in (pressure, shear, angle))
        held = min(dragged, FRICTION * pressed) if self.controls["cone"] else dragged
        return traction_of(pressed, held, towards)

    def _show_load_of_pad(self) -> None:
        """Set the sliders to the load of the chosen pad."""
        pressure, shear, angle = sliders_of(self._traction[self.controls["pad"]])
        values = round(pressure, 2), round(shear, 2), float(round(angle))
        self.controls |= dict(zip(LOAD_SLIDERS, values, strict=True))
