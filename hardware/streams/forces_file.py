"""Files of the forces of a recording: NetCDF, MCAP with the counts beside, MCAP of ROS 2 messages."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from geometry.errors import FileFormatError
from geometry.storage.netcdf import write_netcdf
from hardware.readout.forces import Forces
from hardware.recording import Recording
from hardware.recording.formats import STATISTICS, recorded_messages
from hardware.recording.mcap_file import Channel, Message, write_mcap
from hardware.recording.topics import FORCES, INFO, SCAN, SENSOR, WRENCH, forces_content, wrench_content
from hardware.streams.ros2_file import ros2_channels, ros2_messages


def write_forces(recording: Recording, forces: Forces, path: Path, ros2: bool = False) -> None:
    """Write forces in the format that the suffix of `path` names, whole or not at all.

    NetCDF (.nc) and MCAP (.mcap) as `docs/frames.md` has them, with `ros2` as its streams.

    Parameters
    ----------
    recording : Recording
        Its calibration and hashes go along: they should be those used.
    forces : Forces
        That `replay` made of it.
    path : Path
        File to write; replaced if it exists.
    ros2 : bool
        Messages of ROS 2 in the MCAP file, in place of JSON.

    Raises
    ------
    FileFormatError
        If the suffix names no format of forces.
    MissingPackageError
        If the package that writes the format is not installed.
    DesignError
        With `ros2`, if nobody knows where the pads are.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc" and not ros2:
        stated = asdict(recording.statistics) | {"calibration": recording.calibration} | dict(recording.made_from)
        write_netcdf(forces.to_xarray().assign_attrs(stated), path)
    elif suffix == ".mcap" and ros2:
        forces.description.require_positions()
        write_mcap(path, ros2_channels(), ros2_messages(recording, forces), profile="ros2")
    elif suffix == ".mcap":
        channels = {topic: Channel.of_json(topic) for topic in (INFO, SCAN, FORCES, WRENCH, SENSOR)}
        write_mcap(path, channels, _messages(recording, forces), {STATISTICS: asdict(recording.statistics)})
    else:
        raise FileFormatError(f"{path}: no form of forces: end the name in {'.mcap' if ros2 else '.nc or .mcap'}.")


def _messages(recording: Recording, forces: Forces) -> Iterator[Message]:
    """Those of the recording, the sensor before the first scan, and the forces and net load behind each.

    Forces are kept to six decimals, since the counts beside them hold the rest.
    """
    axes, net, k = forces.description.axes, forces.net(), 0
    for message in recorded_messages(recording):
        yield message
        at = {"log_ns": message.log_ns, "publish_ns": message.log_ns}
        if message.topic == INFO:
            yield Message(topic=SENSOR, content=forces.description.plain(), **at)
            continue
        deviation_n = None if forces.deviation_n is None else forces.deviation_n[k]
        content = {"time": message.log_ns / 10**9} | forces_content(forces.force_n[k], deviation_n, axes)
        yield Message(topic=FORCES, content=content, **at)
        yield Message(topic=WRENCH, content=wrench_content({name: each[k] for name, each in net.items()}), **at)
        k += 1
