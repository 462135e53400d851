"""A recording, and the forces found in it, as one MCAP file."""

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.files import replacing
from hardware.recording.mcap_recorder import McapRecorder
from hardware.recording.recorded import Recording, frames_of

if TYPE_CHECKING:
    from hardware.replay import Replay

_STEP = 256  # frames, then their forces: messages of one time stay together in the file


def export_mcap(recording: Recording, forces: "Replay | None", path: Path, axes: tuple[str, ...] = ()) -> None:
    """Write a recording as MCAP, whole or not at all.

    Parameters
    ----------
    recording : Recording
        Of any kind. Without times of arrival its messages bear the board's clock.
    forces : Replay, optional
        Of the same recording.
    path : Path
        File to write; replaced if it exists.
    axes : tuple of k names
        The components of the forces.
    """
    n = len(recording.counts)
    if forces is not None and forces.force_n.shape[::3] != (n, len(axes)):
        raise ValueError(
            f"forces.force_n has shape {forces.force_n.shape}, expected ({n}, rows, cols, {len(axes)}): "
            "give the replay of this recording and a name for each of its axes."
        )
    times = (recording.time_s if recording.received_s is None else recording.received_s).tolist()
    frames = frames_of(recording)
    with replacing(path) as temporary:
        temporary.unlink()  # a recorder makes its own
        with McapRecorder(temporary, recording.info, recording.calibration, dict(recording.made_from)) as recorder:
            for start in range(0, n, _STEP):
                some = slice(start, start + _STEP)
                recorder.append(islice(frames, _STEP), times[some])
                if forces is not None:
                    for k, time_s in enumerate(times[some], start=start):
                        deviation_n = None if forces.deviation_n is None else forces.deviation_n[k]
                        recorder.append_forces(time_s, forces.force_n[k], axes, deviation_n)
            recorder.close(recording.statistics)
