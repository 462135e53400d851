"""The page of one browser: its messages are checked and done; the array follows, and what has changed is sent back.

Its controls or a sensor load the array. A picture and numbers follow.
"""

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from reprlib import repr as shortened
from typing import Any

import numpy as np
from aiohttp import WSMsgType, web

from common.errors import TriPillarError
from dataset.loads import loads_of
from fem.pictures.arrays import ArrayField, indenter_tractions
from fem.pictures.deformation import Bar
from geometry.layout import FloatArray
from tripillar.viewer.page.controls import (
    ControlError,
    controls_of,
    mapping,
    numbers_of,
    sliders_of,
    taken,
    traction_of,
)
from tripillar.viewer.page.pictures import Pictures
from tripillar.viewer.page.scene import MIN_SHARE, ArrayScene
from tripillar.viewer.page.sensing import PressedSensor, Reading, SensorFeed
from tripillar.viewer.panels import beyond_linear

LOAD_SLIDERS = "pressure", "shear", "angle"  #: of the chosen pad
MAX_DRAWN = 1.0  #: strain of a pillar that is drawn; forces of a broken sensor would tear the array to pieces
UNDRAWN = "drawn at rest: no pillar bears these forces"
HALF_WIDTHS = 4.0  #: of a sensor's forces, that colours span at least
MIN_FORCE_N = 10.0  #: that colours of the maps span at least, less of a sensor of less force
CAP_PCT = 30  #: largest pillar strain of the datasets and of the paper
MAX_A_SECOND = 200  #: messages that are read; a screen gives 60 moves of the mouse
BURST_S = 1.0  #: worth of messages that are read at once after a silence
MAX_PIXELS_A_SIDE = 4096
TURN_DEG, NEARER, MOVED = 360.0, (0.1, 10.0), 5.0  #: bounds of one gesture


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """The array that all browsers look at; none changes it."""

    field: ArrayField  #: prepared for many loads
    sensor: PressedSensor
    decoupler: str  #: name of what turns resistances into forces
    feed: SensorFeed | None = None  #: of a sensor that can load the array in place of the controls


class Page:
    """State of one browser's page, with its scene and its pictures.

    Messages are JSON objects, usually of one name. From the browser: "set" {control: value}, "do" one of `calls`,
    "turn" [right, up] in degrees, "nearer" factor, "move" [right, up] in pictures' heights, "size" [wide, high] in
    pixels, and "restore", a state. To it: "facts", "show" with what has changed, and "refused" with the reason.
    Pictures are the binary messages.
    """

    def __init__(self, subject: Subject) -> None:
        self._subject, self._design = subject, subject.field.design
        self._traction = np.zeros((self._design.n_units, 3))
        self._generator = np.random.default_rng(0)
        self._loads = loads_of(subject.sensor.response)
        self._full_n = self._loads.normal_mpa[1] * self._design.pad.size_mm**2  # largest usual force on a pad
        self._kinds = controls_of(self._design, subject.feed is not None, self._loads)
        self.controls: dict[str, Any] = {name: kind.start for name, kind in self._kinds.items()}
        self._shown: dict[str, Any] = {"controls": {}}  # as the browser has it
        self._is_changed = asyncio.Event()
        self._is_changed.set()
        self.scene = ArrayScene(subject.field, self._loads.normal_mpa[1])
        camera, self.pictures = self.scene.camera, Pictures(self.scene.plotter, self.scene.fit)
        #: what a browser can have done, without further words
        self.calls: dict[str, Callable[[], None]] = {"reset": self._reset, "home": self.scene.look_from_the_start}
        if subject.feed is not None:
            self.calls["again"] = subject.feed.play_again
            subject.feed.listeners.add(self._hear)
        self._takers: dict[str, Callable[[Any], None]] = {
            "set": self.set,
            "do": self._do,
            "turn": lambda said: camera.turn(*numbers_of("turn", said, 2, -TURN_DEG, TURN_DEG)),
            "nearer": lambda said: camera.approach(*numbers_of("nearer", [said], 1, *NEARER)),
            "move": lambda said: camera.move(*numbers_of("move", said, 2, -MOVED, MOVED)),
            "size": lambda said: self.pictures.resize(*numbers_of("size", said, 2, 1.0, MAX_PIXELS_A_SIDE)),
            "restore": self._restore,
        }

    def close(self) -> None:
        """Let go of the scene and of the sensor."""
        if self._subject.feed is not None:
            self._subject.feed.listeners.discard(self._hear)
        self.scene.plotter.close()

    # a browser, while it is there

    async def run(self, socket: web.WebSocketResponse) -> None:
        """Listen, tell and draw until the browser leaves."""

        async def send(**message: Any) -> None:
            await socket.send_str(json.dumps(message, allow_nan=False))

        async def tell() -> None:
            """Send what has changed whenever something has, until cancelled."""
            while True:
                await self._is_changed.wait()
                self._is_changed.clear()
                shown = self.update() | {"controls": dict(self.controls)}
                changed = news(self._shown, shown) | {"controls": news(self._shown["controls"], shown["controls"])}
                self._shown |= shown
                await send(show=changed)

        try:
            await send(facts=self._facts())
            async with asyncio.TaskGroup() as group:
                working = [group.create_task(one) for one in (tell(), self.pictures.run(socket.send_bytes))]
                next_s = 0.0
                async for message in socket:
                    try:
                        if message.type is WSMsgType.PING:
                            await socket.pong(message.data)
                        elif message.type is WSMsgType.TEXT:
                            self._take(message.data)
                        elif message.type is not WSMsgType.PONG:
                            raise ControlError("messages are text.")
                    except ControlError as error:
                        await send(refused=str(error))
                    now_s = time.monotonic()
                    next_s = max(next_s, now_s - BURST_S) + 1.0 / MAX_A_SECOND
                    await asyncio.sleep(max(next_s - now_s, 0.0))  # others have their turn, a flood waits in its sender
                for task in working:
                    task.cancel()
        except* ConnectionResetError:  # it left meanwhile
            pass

    def _take(self, text: str) -> None:
        """Do what a message says; ControlError if it is none of those that `Page` names."""
        try:
            said = json.loads(text)
        except (ValueError, RecursionError):
            raise ControlError("a message is no JSON.") from None
        for name, value in mapping("a message", said).items():
            if name not in self._takers:
                raise ControlError(f"there is no message {shortened(name)}.")
            self._takers[name](value)
            if name in ("turn", "nearer", "move", "do"):
                self.pictures.schedule_render()

    def _facts(self) -> dict[str, Any]:
        """The facts that do not change: the array, and the values that each control may take."""
        array, feed = self._design.array, self._subject.feed
        return {
            "rows": array.rows,
            "cols": array.cols,
            "pitch_mm": array.pitch_mm,
            "pads": self._design.pad.kind,
            "pillars": self._design.unit.layout.pillar_names,
            "cap": CAP_PCT,
            "least_n": min(MIN_FORCE_N, MIN_SHARE * self._full_n),
            "friction": round(self._loads.friction, 3),
            "decoupler": self._subject.decoupler,
            "sensor": None if feed is None else feed.port,
            "kinds": {name: asdict(kind) for name, kind in self._kinds.items()},
        }

    # what it may say

    def set(self, said: object) -> None:
        """Take values of controls, {name: value}; ControlError, and none is taken, if one is not sound."""
        given = taken(self._kinds, said)
        self.controls |= given
        self._shown["controls"] |= given
        if self.controls["source"] == "pads":
            if given.keys() & {*LOAD_SLIDERS, "cone"}:
                self._traction[self.controls["pad"]] = self._held(*LOAD_SLIDERS)
            elif given.keys() & {"pad", "source"}:
                values = sliders_of(self._traction[self.controls["pad"]], self._loads)
                self.controls |= dict(zip(LOAD_SLIDERS, values, strict=True))
        self._is_changed.set()

    def _restore(self, said: object) -> None:
        """Take all controls, and the pads' tractions as `update` gave them. Errors as of `set`."""
        state = mapping("a state", said)
        if state.keys() != {"controls", "traction_mpa"}:
            raise ControlError(f"a state has 'controls' and 'traction_mpa', not {shortened(list(state))}.")
        given, n = taken(self._kinds, state["controls"]), 3 * self._design.n_units
        traction = np.array(numbers_of("traction_mpa", state["traction_mpa"], n, -1e3, 1e3)).reshape(-1, 3)
        most_mpa = np.array([self._loads.tangential_mpa[1]] * 2 + [self._loads.normal_mpa[1]])
        self._traction = np.clip(traction, -most_mpa, most_mpa * (1, 1, 0))
        self.controls |= given
        self._is_changed.set()

    def _do(self, said: object) -> None:
        """Do one of `calls`; ControlError if it is none."""
        if not isinstance(said, str) or said not in self.calls:
            raise ControlError(f"do={shortened(said)} is none of {', '.join(self.calls)}.")
        self.calls[said]()

    def _reset(self) -> None:
        """Take all loads off."""
        self._traction[:] = 0.0
        self.controls |= dict.fromkeys((*LOAD_SLIDERS, "peak", "at_x", "at_y", "drag", "drag_angle"), 0.0)
        self._is_changed.set()

    def _hear(self) -> None:
        """Follow the sensor, which has something new."""
        if self.controls["source"] == "sensor":
            self._is_changed.set()

    # what it is shown

    def update(self) -> dict[str, Any]:
        """Load the array, schedule its picture, and return what the page shows beside it.

        Numbers of units are lists of three a unit, along x, y, z, or of one a pillar; None where unknown. All is
        "trouble" alone where forces or displacements are unknown.
        """
        start, controls, feed = time.perf_counter(), self.controls, self._subject.feed
        try:
            reading = self._loaded()
        except TriPillarError as error:
            return {"trouble": str(error)}
        self._traction, strain = reading.traction_mpa, float(reading.strain.max())
        is_drawn = strain <= MAX_DRAWN
        drawn = self._traction if is_drawn else 0.0 * self._traction
        looks = {"colour": "colour", "scale": "scale", "chosen": "pad", "is_dark": "dark"}
        asked: dict[str, Any] = {name: controls[control] for name, control in looks.items()}
        bar = self.scene.show(drawn, reading.change, **asked, min_share=self._min_share(reading))
        seconds = time.perf_counter() - start
        self.pictures.schedule_render(hurries=controls["source"] != "sensor")  # its scans never rest
        shown: dict[str, Any] = {
            "trouble": "",
            "legend": [legend(bar), legend(self.scene.pads_bar)],
            "scale_note": "true scale" if controls["scale"] == 1 else f"displacement × {controls['scale']}",
            "strain_note": (beyond_linear(strain) or "linear") if is_drawn else UNDRAWN,
            "times": f"computed in {1e3 * seconds:.0f} ms, drawn in {self.pictures.draw_ms:.0f} ms",
            "traction_mpa": listed(self._traction, 4),
            "applied_n": listed(reading.applied_n, 3),
            "force_n": listed(reading.force_n, 3),
            "half_width_n": listed(reading.half_width_n, 3),
            "moment_nmm": listed(reading.moment_nmm, 1),
            "moment_half_width_nmm": listed(reading.moment_half_width_nmm, 1),
            "resistance_ohm": listed(reading.resistance_ohm, 3),
            "change_pct": listed(100.0 * reading.change, 4),
            "strain_pct": listed(100.0 * reading.strain, 4),
        }
        if feed is not None:
            of_scan = {"faults": feed.faults, "contacts": feed.contacts} if controls["source"] == "sensor" else {}
            shown |= {"link": feed.link, "ended": feed.ended, "faults": [], "contacts": []} | of_scan
            shown["is_stale"] = feed.is_stale and controls["source"] == "sensor"
            shown["trouble"] = feed.trouble or (feed.link if shown["is_stale"] else "")
        return shown

    def _loaded(self) -> Reading:
        """Load the array as the controls or the sensor say, and read it."""
        controls, sensor, feed = self.controls, self._subject.sensor, self._subject.feed
        if controls["source"] == "sensor" and feed is not None and feed.scan is not None:
            return sensor.follow(feed.scan)
        if controls["source"] == "indenter":
            at_middle, centre = self._held("peak", "drag", "drag_angle"), (controls["at_x"], controls["at_y"])
            self._traction = indenter_tractions(self._design, at_middle, centre, controls["width"])
        reading = sensor.read(self._traction, controls["noise"], self._generator)
        unknown = np.full_like(reading.applied_n, np.nan)
        return replace(reading, applied_n=unknown) if controls["source"] == "sensor" else reading

    def _min_share(self, reading: Reading) -> float:
        """Share of the full scale that colours span at least: some half-widths of a sensor's forces, if it has any."""
        if reading.half_width_n is None or np.isnan(reading.half_width_n[..., 2]).all():
            return MIN_SHARE
        return max(MIN_SHARE, HALF_WIDTHS * float(np.nanmax(reading.half_width_n[..., 2])) / self._full_n)

    def _held(self, pressure: str, shear: str, angle: str) -> FloatArray:
        """The traction (3,) [MPa] of three sliders, within friction if the page asks for that."""
        pressed, dragged, towards = (self.controls[name] for name in (pressure, shear, angle))
        held = min(dragged, self._loads.friction * pressed) if self.controls["cone"] else dragged
        return traction_of(pressed, held, towards)


def listed(values: FloatArray | None, digits: int) -> list[float | None]:
    """Values as one rounded list, an empty one of none; None for those that are not finite."""
    if values is None:
        return []
    return [number if np.isfinite(number) else None for number in values.ravel().round(digits).tolist()]


def legend(bar: Bar) -> dict[str, Any]:
    """A colour bar: its title, colours from low to high, and labels with their places as fractions of it."""
    labels = [[(value - bar.low) / (bar.high - bar.low), words] for value, words in bar.labels.items()]
    return {"title": bar.title, "colours": [*bar.colours[::15], bar.colours[-1]], "labels": labels}


def news(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """The items of `new` that `old` lacks or has otherwise.

    >>> news({"a": 1, "b": 2}, {"a": 1, "b": 3})
    {'b': 3}
    """
    return {name: value for name, value in new.items() if name not in old or old[name] != value}
