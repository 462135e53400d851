"""Rerun's stream: a file read back by the SDK's own reader, and what its program receives over gRPC."""

import shutil
import socket
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from hardware.readout.wrench import SIGNS
from hardware.streams.addresses import ROOM_BYTES, StreamError
from hardware.streams.rerun_stream import TIMELINE, RerunStream
from hardware.streams.scene import LONGEST, Painter

chunk = pytest.importorskip("rerun.chunk")


def read(path):
    """Rows of an .rrd file by entity and column, in the order of the stamps; static ones under the time None."""
    found = {}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "RRD file has no footer")  # its program was ended
        reader = chunk.RrdReader(path)
    for piece in reader.stream():
        batch = piece.to_record_batch()
        times = [None] * len(batch) if piece.is_static else batch[TIMELINE].cast("int64").to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                rows = found.setdefault((piece.entity_path, name.partition(":")[2]), [])
                rows += zip(times, batch[name].to_pylist(), strict=True)
    return {key: sorted(rows, key=lambda row: row[0] or 0) for key, rows in found.items()}


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def check(found, description, sent):
    """What a file holds is what was sent, at its stamps."""
    painter, stamps = Painter(description), [frame.stamp_ns for frame in sent]
    per_newton = LONGEST * painter.pad_m / painter.full_scale_n
    assert [time_ns for time_ns, _ in found["/sensor/forces", "vectors"]] == stamps
    for k, frame in enumerate(sent):
        vectors, origins = (np.array(found["/sensor/forces", name][k][1]) for name in ("vectors", "origins"))
        single = {"rel": 1e-6, "abs": 1e-6}  # precision
        assert vectors / per_newton == pytest.approx(frame.force_n.reshape(-1, 3) * SIGNS, abs=1e-3)
        assert vectors + origins == pytest.approx(description.position_m.reshape(-1, 3), **single)
        assert found["/net/force_n", "scalars"][k][1] == frame.wrench.force_n.tolist()
        assert found["/net/centre_of_pressure_mm", "scalars"][k][1] == frame.wrench.centre_mm.tolist()
        assert found["/resistance_ohm/x", "scalars"][k][1] == frame.resistance_ohm[..., 1].reshape(-1).tolist()
    [(_, [stated])] = found["/sensor/description", "text"]
    assert description.design_hash in stated


def test_a_file_holds_what_was_sent(board, tmp_path):
    path = tmp_path / "shown.rrd"
    with RerunStream(board.description, host=None, rrd=path) as stream:
        for frame in (sent := board.take(20)):
            stream.add(frame)
    check(read(path), board.description, sent)
    before = path.read_bytes()
    with pytest.raises(StreamError, match="exists: give another name"), RerunStream(board.description, rrd=path):
        pass
    assert path.read_bytes() == before


def test_reruns_own_program_receives_what_was_sent(board, tmp_path):
    """It connects late, is told what was sent before, and saves all that comes."""
    path, port = tmp_path / "received.rrd", free_port()
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    command = [sys.executable, "-m", "rerun_cli", "--connect", url, "--save", str(path)]
    command += ["--bind", "127.0.0.1", "--port", str(free_port())]
    with RerunStream(board.description, port=port) as stream:
        for frame in (sent := board.take(10)):
            stream.add(frame)
        with pytest.raises(StreamError, match="give another address"), RerunStream(board.description, port=port):
            pass
        client = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            size = wait_for_bytes(path, 0)
            for frame in (more := board.take(10)):
                stream.add(frame)
            wait_for_bytes(path, size)
        finally:
            client.terminate()
            client.wait(10)
    check(read(path), board.description, sent + more)


def wait_for_bytes(path, more_than):
    """Wait until a file has grown beyond some bytes and grows no more; its size."""
    size = quiet = 0
    end_s = time.monotonic() + 20
    while size <= more_than or quiet < 10:
        assert time.monotonic() < end_s
        time.sleep(0.02)
        now = path.stat().st_size if path.exists() else 0
        quiet, size = quiet + 1 if now == size else 0, now
    return size


def test_a_full_disk_ends_the_file_and_all_of_it_is_read(board, tmp_path, monkeypatch):
    path = tmp_path / "shown.rrd"
    free, usage = [10 * ROOM_BYTES], shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: usage._replace(free=free[0]))
    sent = board.take(20)
    with RerunStream(board.description, host=None, rrd=path) as stream:
        for frame in sent:
            stream.add(frame)
        free[0] = ROOM_BYTES - 1
        with pytest.raises(StreamError, match=r"shown.rrd: the disk is full \(4095 kB left\): the file ends here"):
            stream.add(sent[0])
    check(read(path), board.description, sent)
