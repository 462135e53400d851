"""Frames for Rerun: a gRPC server that viewers connect to, and an .rrd file. Needs the package ``rerun-sdk``."""

import json
from pathlib import Path
from typing import Any, Self

import numpy as np

from common.errors import needing
from geometry.layout import AXES
from hardware.readout.description import SensorDescription
from hardware.readout.forces import Forces
from hardware.streams.scene import ARROW_COLOUR, CONTACT_COLOUR, NET_COLOUR, PAD_HEIGHT, THICK, scene_of
from hardware.streams.stream import LOOPBACK, listening_on, make_file, require_room

PORT = 9876  #: where a viewer looks for a server
TIMELINE = "board"  #: the frames' stamps
KEPT = "256MiB"  #: of the newest frames, for viewers that connect later
SERVED_S, FILED_S = 0.05, 1.0  #: longest time that a frame waits, for viewers and for a file alone


class RerunStream:
    """Sends frames to all who are connected, and into a file, as long as the with block lasts.

    Entities are ``sensor`` (description, pads in colours, forces and net force as arrows), ``net`` and ``force_n`` and
    ``resistance_ohm`` (numbers over time). All else is as of `Stream`.
    """

    def __init__(
        self, sensor: SensorDescription, host: str | None = LOOPBACK, port: int = PORT, rrd: Path | None = None
    ) -> None:
        with needing("Rerun", "rerun"):
            import rerun
        self._rerun: Any = rerun
        sensor.require_positions()
        self._sensor, self._host, self._port, self._rrd = sensor, host, port, rrd

    def __enter__(self) -> Self:
        rr, sinks = self._rerun, []
        if self._host is not None:
            listening_on(self._host, self._port).close()  # refuses a port that is taken, which the sink would not
            sinks.append(rr.GrpcServerSink(self._host, self._port, server_memory_limit=KEPT))
        if self._rrd is not None:
            make_file(self._rrd)  # refuses what cannot be written, which the sink would not
            sinks.append(rr.FileSink(self._rrd))
        batches = rr.ChunkBatcherConfig(flush_tick=FILED_S if self._host is None else SERVED_S)
        self._recording = rr.RecordingStream("tripillar", batcher_config=batches)
        self._recording.set_sinks(*sinks, default_blueprint=self._blueprint())
        self._is_first = True
        return self

    def __exit__(self, *error: object) -> None:
        self._recording.flush()
        self._recording.disconnect()

    def add(self, scan: Forces) -> None:
        """Send the forces of one scan."""
        if self._rrd is not None:
            require_room(self._rrd)  # the sink tells nobody when it fails
        if self._is_first:
            self._is_first = False
            self._state_sensor(scan)
        rr, log, scene = self._rerun, self._recording.log, scene_of(scan)
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(int(scan.stamp_ns), "ns"))
        log("sensor/pads", rr.Boxes3D.from_fields(colors=scene.pad_colours))
        log("sensor/forces", rr.Arrows3D(vectors=scene.arrows_m, origins=scene.places_m - scene.arrows_m))
        log("sensor/net", rr.Arrows3D(vectors=scene.net_arrow_m, origins=scene.net_tip_m - scene.net_arrow_m))
        if scan.contacts is not None:
            log("sensor/contacts", rr.Ellipsoids3D(centers=scene.contact_centres_m, half_sizes=scene.contact_halves_m))
        for name, (_, values) in self._plots(scan).items():
            log(name, rr.Scalars(values))

    def _plots(self, scan: Forces) -> dict[str, tuple[list[str], Any]]:
        """Names of entities with those of their lines and the values: of all units row by row, or of the net load."""
        wrench, sensor = scan.wrench, self._sensor
        units = [f"row {i}, col {j}" for i, j in np.ndindex(sensor.rows, sensor.cols)]
        forces = {f"force_n/{axis}": scan.force_n[..., k] for k, axis in enumerate(sensor.axes)}
        ohms = {
            f"resistance_ohm/{pillar}": scan.resistance_ohm[..., k]
            for k, pillar in enumerate(sensor.layout.pillar_names)
        }
        return {name: (units, values.reshape(-1)) for name, values in (forces | ohms).items()} | {
            "net/force_n": ([f"F{axis}" for axis in AXES], wrench.force_n),
            "net/moment_nmm": ([f"M{axis}" for axis in AXES], wrench.moment_nmm),
            "net/centre_of_pressure_mm": (list(AXES[:2]), wrench.centre_mm),
        }

    def _state_sensor(self, scan: Forces) -> None:
        """Log what does not change."""
        rr, scene = self._rerun, scene_of(scan)
        side, height = scene.pad_m, PAD_HEIGHT * scene.pad_m
        static = {
            "sensor": rr.ViewCoordinates.RIGHT_HAND_Z_UP,
            "sensor/description": rr.TextDocument(json.dumps(self._sensor.plain(), indent=1)),
            "sensor/pads": rr.Boxes3D(
                centers=scene.places_m - [0.0, 0.0, height / 2],
                half_sizes=np.tile([side / 2, side / 2, height / 2], (len(scene.places_m), 1)),
                fill_mode="solid",
            ),
            "sensor/forces": rr.Arrows3D.from_fields(colors=ARROW_COLOUR, radii=THICK * side / 2),
            "sensor/contacts": rr.Ellipsoids3D.from_fields(colors=CONTACT_COLOUR),
            "sensor/net": rr.Arrows3D.from_fields(colors=NET_COLOUR, radii=THICK * side),
            **{name: rr.SeriesLines(names=lines) for name, (lines, _) in self._plots(scan).items()},
        }
        for name, content in static.items():
            self._recording.log(name, content, static=True)

    def _blueprint(self) -> Any:
        """The array beside plots of the net force, the centre of pressure and the resistances."""
        import rerun.blueprint as rrb

        plots = [
            rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=has_legend))
            for origin, name, has_legend in (
                ("net/force_n", "Net force [N]", True),
                ("net/centre_of_pressure_mm", "Centre of pressure [mm]", True),
                ("resistance_ohm", "Resistances [Ω]", False),  # a line a pillar: a legend would be cut off
            )
        ]
        array = rrb.Spatial3DView(origin="sensor", name="Forces")
        return rrb.Blueprint(rrb.Horizontal(array, rrb.Vertical(*plots)), collapse_panels=True)
