"""Streams of forces to Foxglove and Rerun: what their files hold, and what a client of each receives."""

import json
import logging
import socket
import struct
import sys
import threading
import time
import warnings
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from common.errors import DesignError, MissingPackageError
from hardware import live
from hardware.boards.python_board import PythonBoard
from hardware.readout.wrench import SIGNS
from hardware.streams.foxglove_stream import MAX_CLIENTS, MAX_WAITING, FoxgloveStream
from hardware.streams.rerun_stream import TIMELINE, RerunStream
from hardware.streams.ros2_file import ros2_stream
from hardware.streams.scene import LONGEST
from hardware.streams.stream import ROOM_BYTES, StreamError
from hardware.streams.topics import CONTACTS, CONTENTS, FORCES, RESISTANCES, SCENE, SENSOR, WRENCH
from tests.hardware.models import INFO
from tests.house import PATIENT_S, room_for

if not find_spec("rerun"):  # which takes 0.3 s to load
    pytest.skip("no rerun", allow_module_level=True)
connect = pytest.importorskip("websockets.sync.client").connect


@pytest.fixture(scope="module")
def board(pressed):
    """A simulated board, live: the `description` of its sensor, and `take(n)` scans of it."""
    with PythonBoard(pressed.counts, INFO) as board, live(board.port, pressed.model) as scans:

        def take(n):
            return [scans.forces(scans.scanner.get(PATIENT_S), renewed_s=0.1) for _ in range(n)]

        yield SimpleNamespace(description=scans.description, take=take)


def rows_of_rrd(path):
    """Rows of an .rrd file by entity and column, in the order of the stamps; static ones under the time None."""
    from rerun import chunk

    found = {}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "RRD file has no footer")  # its program was ended
        opened = chunk.RrdReader(path)
    for piece in opened.stream():
        batch = piece.to_record_batch()
        times = [None] * len(batch) if piece.is_static else batch[TIMELINE].cast("int64").to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                rows = found.setdefault((piece.entity_path, name.partition(":")[2]), [])
                rows += zip(times, batch[name].to_pylist(), strict=True)
    return {key: sorted(rows, key=lambda row: row[0] or 0) for key, rows in found.items()}


def scale(description):
    """Metres of an arrow per newton."""
    return LONGEST * 1e-3 * description.pad_mm / description.full_scale_n


def check_rrd(path, description, sent):
    found = rows_of_rrd(path)
    assert [time_ns for time_ns, _ in found["/sensor/forces", "vectors"]] == [scan.stamp_ns for scan in sent]
    for k, scan in enumerate(sent):
        arrows_m, origins_m = (np.array(found["/sensor/forces", name][k][1]) for name in ("vectors", "origins"))
        assert arrows_m / scale(description) == pytest.approx(scan.force_n.reshape(-1, 3) * SIGNS, abs=1e-3)
        assert arrows_m + origins_m == pytest.approx(1e-3 * description.position_mm.reshape(-1, 3), abs=1e-6)
        assert found["/net/force_n", "scalars"][k][1] == scan.wrench.force_n.tolist()
        assert found["/net/centre_of_pressure_mm", "scalars"][k][1] == scan.wrench.centre_mm.tolist()
        assert found["/resistance_ohm/x", "scalars"][k][1] == scan.resistance_ohm[..., 1].reshape(-1).tolist()
    [(_, [stated])] = found["/sensor/description", "text"]
    assert description.design_hash in stated


def check_contents(content, description, sent):
    """Numbers as they were sent; each arrow ends at its pad and is as long as its force, the last is the net force."""
    pads_m = 1e-3 * description.position_mm.reshape(-1, 3)
    for k, scan in enumerate(sent):
        forces, net, ohms, scene = (content(topic, k) for topic in (FORCES, WRENCH, RESISTANCES, SCENE))
        vectors_n = scan.force_n.reshape(-1, 3)
        assert np.array([unit["force_n"] for unit in forces["units"]]) == pytest.approx(vectors_n, abs=1e-6)
        assert net["centre_of_pressure_mm"] == pytest.approx(scan.wrench.centre_mm, rel=1e-5)
        resistance_ohm = np.array([unit["resistance_ohm"] for unit in ohms["units"]])
        assert resistance_ohm == pytest.approx(scan.resistance_ohm.reshape(-1, 3), abs=1e-3)
        [entity] = scene["entities"]
        stamp = entity["timestamp"]
        assert (entity["frame_id"], stamp["sec"] * 10**9 + stamp["nsec"]) == ("tripillar", scan.stamp_ns)
        arrows = [
            (*each["pose"]["position"].values(), *each["pose"]["orientation"].values()) for each in entity["arrows"]
        ]
        tails_m, turns = np.split(np.array(arrows), [3], axis=1)
        lengths_m = np.array([[each["shaft_length"] + each["head_length"]] for each in entity["arrows"]])
        arrows_m = lengths_m * Rotation.from_quat(turns).apply([1.0, 0.0, 0.0])
        net_m = [*1e-3 * scan.wrench.centre_mm, 0.0]
        assert (tails_m + arrows_m) == pytest.approx(np.array([*pads_m, net_m]), abs=1e-9)
        expected = np.array([*vectors_n * SIGNS, scan.wrench.vector_n / 6**0.5])
        assert arrows_m / scale(description) == pytest.approx(expected, abs=1e-6)
        assert len(entity["cubes"]) == 6


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_rerun_holds_and_serves_what_was_sent(board, tmp_path):
    port, path, sent = free_port(), tmp_path / "shown.rrd", board.take(10)
    with RerunStream(board.description, port=port, rrd=path) as stream:
        socket.create_connection(("127.0.0.1", port)).close()
        for scan in sent:
            stream.add(scan)
    check_rrd(path, board.description, sent)


@pytest.mark.parametrize(("kind", "stream_of"), [
    ("mcap", ros2_stream), ("rrd", lambda sensor, path: RerunStream(sensor, host=None, rrd=path)),
])  # fmt: skip
def test_a_file_is_never_overwritten_and_ends_with_a_full_disk(board, tmp_path, kind, stream_of):
    """A limit on the size of files is a full disk."""
    path = tmp_path / f"shown.{kind}"
    with stream_of(board.description, path) as stream:
        with room_for(ROOM_BYTES - 1), pytest.raises(StreamError, match=rf"shown.{kind}: the disk is full"):
            stream.add(board.take(1)[0])
        stream.add(board.take(1)[0])
    before = path.read_bytes()
    with pytest.raises(StreamError, match="exists: give another name"):
        stream_of(board.description, path).__enter__()
    assert path.read_bytes() == before


@pytest.mark.parametrize(("package", "stream"), [("websockets", FoxgloveStream), ("rerun", RerunStream)])
def test_what_cannot_be_streamed_is_refused(board, monkeypatch, tmp_path, package, stream):
    """A sensor of unknown pads, a port that is taken, a package that is missing; no file is left."""
    unknown = type(board.description)(**vars(board.description) | {"position_mm": np.full((2, 3, 3), np.nan)})
    with pytest.raises(DesignError, match="model states no design"):
        stream(unknown)
    with pytest.raises(DesignError, match="model states no design"):
        ros2_stream(unknown, tmp_path / "never.mcap").__enter__()
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = stream(board.description, "127.0.0.1", other.getsockname()[1], tmp_path / "never")
        with pytest.raises(StreamError, match="give another address"), taken:
            pass
    assert not any(tmp_path.iterdir())
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackageError, match=r"pip install 'tripillar\[(foxglove|rerun)\]'"):
        stream(board.description)


def wait_for(is_so):
    end_s = time.monotonic() + PATIENT_S
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def subscribing(ids):
    return json.dumps({"op": "subscribe", "subscriptions": [{"id": 100 + k, "channelId": k} for k in ids]})


def test_a_client_of_foxglove_receives_what_was_sent(board):
    with (
        FoxgloveStream(board.description, port=0) as stream,
        connect(f"ws://127.0.0.1:{stream.port}", subprotocols=["foxglove.sdk.v1"]) as client,
    ):
        stream.add((sent := board.take(30))[0])  # before anyone listens: the description is kept for who comes later
        assert json.loads(client.recv())["op"] == "serverInfo"
        topics = {100 + channel["id"]: channel["topic"] for channel in json.loads(client.recv())["channels"]}
        client.send(subscribing(id - 100 for id in topics))
        wait_for(lambda: stream.has_listeners(SCENE))
        for scan in sent[1:]:
            stream.add(scan)
        stream.__exit__(None, None, None)  # which waits until all is read
        found = {}
        for message in client:
            _, subscription, log_ns = struct.unpack_from("<BIQ", message)
            found.setdefault(topics[subscription], []).append((log_ns, json.loads(message[13:])))
    assert [content for _, content in found.pop(SENSOR)] == [board.description.plain()]
    assert set(found) == set(CONTENTS) - {CONTACTS}
    for received in found.values():
        assert [log_ns for log_ns, _ in received] == [scan.stamp_ns for scan in sent[1:]]
    check_contents(lambda topic, k: found[topic][k][1], board.description, sent[1:])


def handshake(port, path="/", **headers):
    """The HTTP status that a client gets, and its connection."""
    asked = {"Host": f"127.0.0.1:{port}", "Upgrade": "websocket", "Connection": "Upgrade"}
    asked |= {"Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    asked |= {"Sec-WebSocket-Protocol": "foxglove.sdk.v1"} | headers
    connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENT_S)
    lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in asked.items()), "", ""]
    connection.sendall("\r\n".join(lines).encode())
    return int(connection.recv(4096).split()[1]), connection


@pytest.mark.parametrize(("token", "asked"), [
    ("", [
        ("/", {}, 101),
        ("/", {"Origin": "https://app.foxglove.dev"}, 101),
        ("/", {"Origin": "http://[::1]:8080"}, 101),
        ("/", {"Origin": "file://"}, 101),
        ("/", {"Origin": "https://foxglove.dev.evil.example"}, 403),
        ("/", {"Origin": "https://evilfoxglove.dev"}, 403),
        ("/", {"Origin": "null"}, 403),  # a page in a sandbox
        ("/", {"Host": "evil.example:8765"}, 403),  # a name that was pointed at this machine
    ]),
    ("secret", [
        ("/", {}, 403),
        ("/?token=secre", {}, 403),
        ("/?token=secret", {"Origin": "https://mine.example"}, 101),
    ]),
])  # fmt: skip
def test_only_known_pages_or_a_token_are_let_in_and_nonsense_is_sent_away_without_a_word(
    board, token, asked, capfd, caplog
):
    with caplog.at_level(logging.DEBUG), FoxgloveStream(board.description, port=0, token=token) as stream:
        for path, headers, status in asked:
            found, connection = handshake(stream.port, path, **headers)
            connection.close()
            assert found == status, (path, headers)
        for said in (b"\0\0\0", b"GET / HTTP/1.1\r\n\r\n", b"POST / HTTP/1.1\r\nHost: a\r\n\r\n", b""):
            with socket.create_connection(("127.0.0.1", stream.port), timeout=PATIENT_S) as connection:
                connection.sendall(said)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):
                    pass
    assert capfd.readouterr() == ("", "")
    assert [record for record in caplog.records if record.name != "asyncio" or record.levelno > logging.DEBUG] == []


def frame_of(text):
    """A masked frame of WebSocket, as clients send them."""
    data = text.encode()
    return bytes([0x81, 0x80 | 126]) + len(data).to_bytes(2, "big") + bytes(4) + data


def test_clients_and_what_waits_for_them_are_bounded(board):
    """Who never reads costs no more than `MAX_WAITING` bytes, and the end waits for none of them."""
    with FoxgloveStream(board.description, port=0) as stream:
        held = [handshake(stream.port) for _ in range(MAX_CLIENTS)]
        wait_for(lambda: len(stream._clients) == MAX_CLIENTS)
        held.append(handshake(stream.port))
        assert [status for status, _ in held] == [101] * MAX_CLIENTS + [503]
        for _, connection in held[:MAX_CLIENTS]:
            for said in ("{", "[]", '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [{}]}', '{"op": "?"}'):
                connection.sendall(frame_of(said))
            connection.sendall(frame_of(subscribing(range(1000))))
        wait_for(lambda: all(map(len, stream._clients.values())))
        assert all(len(subscribed) == 6 for subscribed in stream._clients.values())
        for k in range(200):
            stream.send(FORCES, k, bytes(100_000))  # more than the system takes for those who do not read
        done = threading.Event()
        stream._loop.call_soon_threadsafe(done.set)
        assert done.wait(PATIENT_S)
        waiting = [client.transport.get_write_buffer_size() for client in stream._clients]
        assert MAX_WAITING <= max(waiting) < MAX_WAITING + 200_000
        every = list(range(100, 1100))
        held[0][1].sendall(frame_of(json.dumps({"op": "unsubscribe", "subscriptionIds": every})))
        wait_for(lambda: not all(stream._clients.values()))
        held[1][1].close()
        wait_for(lambda: len(stream._clients) < MAX_CLIENTS)
        held.append(handshake(stream.port))
        assert held[-1][0] == 101  # there is room again
    for _, connection in held:
        connection.close()
