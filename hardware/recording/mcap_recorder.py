"""Recording to MCAP, for Foxglove and ROS tools: JSON messages with their schemas; needs the package ``mcap``.

Each flush ends a compressed chunk with a checksum and an index of its own, so a killed recorder leaves whole chunks
and at most one torn. What follows the chunks only makes the file quicker to open.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import IO, Any

import numpy as np

from geometry.files import replacing
from geometry.layout import FloatArray
from hardware.frames import Frame, Statistics
from hardware.recording.mcap_reader import STATISTICS, McapContent, require_mcap
from hardware.recording.mcap_schemas import FORCES, INFO, SCAN, SCHEMAS
from hardware.recording.recorder import FrameRecorder


class McapRecorder(FrameRecorder):
    """Records to MCAP; `FrameRecorder` says what is taken and what is refused.

    Messages bear the Unix time of arrival as their log time and the board's clock as their publish time. Forces may be
    kept beside the frames (`append_forces`). To continue a file, what it holds is copied once.
    """

    def _start(self, file: IO[bytes]) -> None:
        from mcap.writer import Writer

        self._file = file
        self._writer = Writer(file)
        self._writer.start(library="tripillar")
        self._channels: dict[str, int] = {}
        self._forces: list[tuple[int, dict[str, Any]]] = []  # waiting, with their log time
        self._before: dict[str, int] = {}  # statistics of the recorder before this one

    def _create(self) -> None:
        require_mcap()
        self._start(self.path.open("xb"))
        self._write([], [])

    def _continue(self) -> None:
        content = McapContent(self.path)
        self._require_same_header(content.header)
        with replacing(self.path) as temporary:
            self._start(temporary.open("wb"))
            for topic, message in content.messages():
                self._writer.add_message(
                    self._channel(topic), message.log_time, message.data, message.publish_time, message.sequence
                )
            self._before = content.statistics
            self._write([], [])

    def append_forces(
        self, time_s: float, force_n: FloatArray, axes: Sequence[str], deviation_n: FloatArray | None = None
    ) -> None:
        """Add the forces found in one scan.

        Parameters
        ----------
        time_s : float
            Unix time of arrival of the scan [s], as given to `append`.
        force_n : array, shape (rows, cols, k)
            Forces [N]; kept to six decimals, since the counts beside them hold the rest.
        axes : k names
            The components.
        deviation_n : array, shape (rows, cols, k)
            Half-widths that hold 68 % of their errors [N], if known.
        """
        self._require_open()
        self._require_time(time_s)
        info = self.header.info
        for name, values in {"force_n": force_n, "deviation_n": deviation_n}.items():
            if values is not None and (
                values.shape != (info.rows, info.cols, len(axes)) or not np.isfinite(values).all()
            ):
                raise ValueError(
                    f"{name} has shape {values.shape}, expected finite values of shape "
                    f"{(info.rows, info.cols, len(axes))}: give one force a unit and axis."
                )
        unknown: list[list[list[float]]] = [[[]] * info.cols] * info.rows
        force = force_n.round(6).tolist()
        deviation = unknown if deviation_n is None else deviation_n.round(6).tolist()
        units = [
            {"row": i, "col": j, "force_n": force[i][j], "deviation_n": deviation[i][j]}
            for i in range(info.rows)
            for j in range(info.cols)
        ]
        message = {"time": time_s, "rows": info.rows, "cols": info.cols, "axes": list(axes), "units": units}
        self._forces.append((_nanoseconds(time_s), message))
        self._flush_if_due()

    def _write(self, frames: Sequence[Frame], received_s: Sequence[float]) -> None:
        if received_s or self._forces:
            self._add_info(_nanoseconds(received_s[0]) if received_s else self._forces[0][0])
        for frame, arrival in zip(frames, received_s, strict=True):
            scan = {
                "sequence": frame.sequence,
                "device_us": frame.device_us,
                "flags": frame.flags,
                "overruns": frame.overruns,
                "counts": frame.counts.tolist(),
            }
            self._message(SCAN, _nanoseconds(arrival), frame.device_us * 1000, scan, frame.sequence)
        for time_ns, forces in self._forces:
            self._message(FORCES, time_ns, time_ns, forces)
        self._forces.clear()
        self._writer.flush()

    def _add_info(self, log_ns: int) -> None:
        """The header, with the time of the first frame: viewers draw their time axis from the first message on."""
        if INFO not in self._channels:
            self._message(INFO, log_ns, log_ns, self.header.plain())

    def _message(self, topic: str, log_ns: int, publish_ns: int, content: dict[str, Any], sequence: int = 0) -> None:
        data = json.dumps(content, separators=(",", ":")).encode()
        self._writer.add_message(self._channel(topic), log_ns, data, publish_ns, sequence)

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            schema = SCHEMAS[topic]
            schema_id = self._writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        return self._channels[topic]

    def _end(self, statistics: Statistics | None) -> None:
        self._add_info(0)  # if there was nothing to record
        counted = asdict(statistics) if statistics else {}
        total = {name: str(self._before.get(name, 0) + counted.get(name, 0)) for name in self._before | counted}
        if total:
            self._writer.add_metadata(STATISTICS, total)
        self._writer.finish()
        self._file.close()

    def _abandon(self) -> None:
        self._file.close()


def _nanoseconds(time_s: float) -> int:
    """Nanoseconds that, divided by 10⁹, give `time_s` to the last bit; a product of floats would be 100 ns off.

    >>> _nanoseconds(1.8e9 + 0.1) / 10**9 == 1.8e9 + 0.1
    True
    """
    seconds = int(time_s)
    return seconds * 10**9 + round((time_s - seconds) * 1e9)
