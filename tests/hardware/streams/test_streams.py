"""Streams of forces to Foxglove and Rerun: what their files hold, and what a client of each receives."""

import json
import logging
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest

from geometry.errors import DesignError, MissingPackageError
from hardware.readout.wrench import SIGNS
from hardware.streams.addresses import ROOM_BYTES, StreamError, host_and_port, make_file, require_room
from hardware.streams.foxglove_server import MAX_CLIENTS, MAX_WAITING
from hardware.streams.foxglove_stream import FoxgloveStream
from hardware.streams.rerun_stream import TIMELINE, RerunStream
from hardware.streams.scene import LONGEST
from hardware.streams.topics import CONTACTS, CONTENTS, FORCES, RESISTANCES, SCENE, SENSOR, WRENCH
from tests.hardware.recording.test_failures import room_for
from tests.hardware.streams.test_exports import messages

chunk = pytest.importorskip("rerun.chunk")
connect = pytest.importorskip("websockets.sync.client").connect


def rows_of_rrd(path):
    """Rows of an .rrd file by entity and column, in the order of the stamps; static ones under the time None."""
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


def check_mcap(path, description, sent):
    found = messages(path)
    assert [content for _, content in found[SENSOR]] == [description.plain()]
    for topic in set(CONTENTS) - {CONTACTS}:
        assert [message.log_time for message, _ in found[topic]] == [scan.stamp_ns for scan in sent], topic
    check_contents(lambda topic, k: found[topic][k][1], description, sent)


def along_x(pose):
    """The direction of a pose's x axis."""
    x, y, z, w = (pose["orientation"][name] for name in "xyzw")
    return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])


def check_contents(content, description, sent):
    """Numbers as they were sent; each arrow ends at its pad and is as long as its force, the last is the net force."""
    pads_m = 1e-3 * description.position_mm.reshape(-1, 3)
    for k, scan in enumerate(sent):
        forces, net, ohms, scene = (content(topic, k) for topic in (FORCES, WRENCH, RESISTANCES, SCENE))
        force_n = np.array([unit["force_n"] for unit in forces["units"]])
        assert force_n == pytest.approx(scan.force_n.reshape(-1, 3), abs=1e-6)
        assert net["centre_of_pressure_mm"] == pytest.approx(scan.wrench.centre_mm, rel=1e-5)
        resistance_ohm = np.array([unit["resistance_ohm"] for unit in ohms["units"]])
        assert resistance_ohm == pytest.approx(scan.resistance_ohm.reshape(-1, 3), abs=1e-3)
        [entity] = scene["entities"]
        stamp = entity["timestamp"]
        assert (entity["frame_id"], stamp["sec"] * 10**9 + stamp["nsec"]) == ("tripillar", scan.stamp_ns)
        arrows_m = np.array(
            [(arrow["shaft_length"] + arrow["head_length"]) * along_x(arrow["pose"]) for arrow in entity["arrows"]]
        )
        tails_m = np.array([list(arrow["pose"]["position"].values()) for arrow in entity["arrows"]])
        net_m = [*1e-3 * scan.wrench.centre_mm, 0.0]
        assert (tails_m + arrows_m) == pytest.approx(np.array([*pads_m, net_m]), abs=1e-9)
        on_pads = scan.force_n.reshape(-1, 3) * SIGNS
        expected = np.array([*on_pads, scan.wrench.vector_n / 6**0.5])
        assert arrows_m / scale(description) == pytest.approx(expected, abs=1e-6)
        assert len(entity["cubes"]) == 6


KINDS = {
    "mcap": (lambda sensor, path: FoxgloveStream(sensor, host=None, mcap=path), check_mcap),
    "rrd": (lambda sensor, path: RerunStream(sensor, host=None, rrd=path), check_rrd),
}
each_kind = pytest.mark.parametrize("kind", KINDS)


@each_kind
def test_a_file_holds_what_was_sent_is_never_overwritten_and_ends_with_a_full_disk(board, tmp_path, monkeypatch, kind):
    path, (opened, check) = tmp_path / f"shown.{kind}", KINDS[kind]
    free, usage, sent = [10 * ROOM_BYTES], shutil.disk_usage(tmp_path), board.take(10)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: usage._replace(free=free[0]))
    with opened(board.description, path) as stream:
        for scan in sent[:-1]:
            stream.add(scan)
        free[0] = ROOM_BYTES - 1
        message = rf"shown.{kind}: the disk is full \(4095 kB left\): the file ends here and can be read"
        with pytest.raises(StreamError, match=message):
            stream.add(sent[-1])
    check(path, board.description, sent if kind == "mcap" else sent[:-1])
    before = path.read_bytes()
    with pytest.raises(StreamError, match="exists: give another name"), opened(board.description, path):
        pass
    assert path.read_bytes() == before
    with pytest.raises(StreamError, match="the disk is full"):
        make_file(tmp_path / "other")
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_a_limit_on_the_size_of_files_is_a_full_disk(tmp_path):
    (path := tmp_path / "file").write_bytes(bytes(1000))
    with room_for(ROOM_BYTES + 1000):
        require_room(path)
    with room_for(ROOM_BYTES + 999), pytest.raises(StreamError, match="the disk is full"):
        require_room(path)


@pytest.mark.parametrize(("package", "stream"), [("websockets", FoxgloveStream), ("rerun", RerunStream)])
def test_what_cannot_be_streamed_is_refused(board, monkeypatch, tmp_path, package, stream):
    """A sensor of unknown pads, a port that is taken, a package that is missing; no file is left."""
    unknown = vars(board.description) | {"position_mm": np.full((2, 3, 3), np.nan)}
    with pytest.raises(DesignError, match="model states no design"):
        stream(type(board.description)(**unknown))
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


@pytest.mark.parametrize("text", ["", ":80", "host:", "host:x", "host:65536", "a/b:1"])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(DesignError, match=r"is no address: give HOST:PORT, such as 127.0.0.1:8765"):
        host_and_port(text, 8765)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_reruns_own_program_receives_what_was_sent(board, tmp_path):
    """It connects late, is told what was sent before, and saves all that comes."""
    path, port = tmp_path / "received.rrd", free_port()
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    command = [sys.executable, "-m", "rerun_cli", "--connect", url, "--save", str(path)]
    command += ["--bind", "127.0.0.1", "--port", str(free_port())]
    with RerunStream(board.description, port=port) as stream:
        for scan in (sent := board.take(10)):
            stream.add(scan)
        client = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            size = wait_for_bytes(path, 0)
            for scan in (more := board.take(10)):
                stream.add(scan)
            wait_for_bytes(path, size)
        finally:
            client.terminate()
            client.wait(10)
    check_rrd(path, board.description, sent + more)


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


def wait_for(is_so):
    end_s = time.monotonic() + 10
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
        stream.add(board.take(1)[0])  # before anyone listens: the description is kept for who comes later
        assert json.loads(client.recv())["op"] == "serverInfo"
        topics = {100 + channel["id"]: channel["topic"] for channel in json.loads(client.recv())["channels"]}
        client.send(subscribing(id - 100 for id in topics))
        wait_for(lambda: stream._server.has_listeners(SCENE))
        for scan in (sent := board.take(30)):
            stream.add(scan)
        stream.__exit__(None, None, None)  # which waits until all is read
        found = {}
        for message in client:
            _, subscription, log_ns = struct.unpack_from("<BIQ", message)
            found.setdefault(topics[subscription], []).append((log_ns, json.loads(message[13:])))
    assert [content for _, content in found[SENSOR]] == [board.description.plain()]
    for topic in set(CONTENTS) - {CONTACTS}:
        assert [log_ns for log_ns, _ in found[topic]] == [scan.stamp_ns for scan in sent]
    check_contents(lambda topic, k: found[topic][k][1], board.description, sent)


def handshake(port, path="/", **headers):
    """The HTTP status that a client gets, and its connection."""
    asked = {"Host": f"127.0.0.1:{port}", "Upgrade": "websocket", "Connection": "Upgrade"}
    asked |= {"Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    asked |= {"Sec-WebSocket-Protocol": "foxglove.sdk.v1"} | headers
    connection = socket.create_connection(("127.0.0.1", port), timeout=10)
    lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in asked.items()), "", ""]
    connection.sendall("\r\n".join(lines).encode())
    return int(connection.recv(4096).split()[1]), connection


@pytest.mark.parametrize(("token", "asked"), [
    ("", [
        ("/", {}, 101),
        ("/", {"Origin": "https://app.foxglove.dev"}, 101),
        ("/", {"Origin": "http://localhost:8080"}, 101),
        ("/", {"Origin": "http://[::1]:8080"}, 101),
        ("/", {"Origin": "file://"}, 101),
        ("/", {"Origin": "https://evil.example"}, 403),
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
            with socket.create_connection(("127.0.0.1", stream.port), timeout=10) as connection:
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
        held, server = [handshake(stream.port) for _ in range(MAX_CLIENTS)], stream._server
        wait_for(lambda: len(server._clients) == MAX_CLIENTS)
        held.append(handshake(stream.port))
        assert [status for status, _ in held] == [101] * MAX_CLIENTS + [503]
        for _, connection in held[:MAX_CLIENTS]:
            for said in ("{", "[]", '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [{}]}', '{"op": "?"}'):
                connection.sendall(frame_of(said))
            connection.sendall(frame_of(subscribing(range(1000))))
        wait_for(lambda: all(map(len, server._clients.values())))
        assert all(len(subscribed) == 6 for subscribed in server._clients.values())
        for k in range(200):
            server.send(FORCES, k, bytes(100_000))  # more than the system takes for those who do not read
        done = threading.Event()
        server._loop.call_soon_threadsafe(done.set)
        assert done.wait(10)
        waiting = [client.transport.get_write_buffer_size() for client in server._clients]
        assert MAX_WAITING <= max(waiting) < MAX_WAITING + 200_000
        every = list(range(100, 1100))
        held[0][1].sendall(frame_of(json.dumps({"op": "unsubscribe", "subscriptionIds": every})))
        wait_for(lambda: not all(server._clients.values()))
        held[1][1].close()
        wait_for(lambda: len(server._clients) < MAX_CLIENTS)
        held.append(handshake(stream.port))
        assert held[-1][0] == 101  # there is room again
        start_s = time.monotonic()
    assert time.monotonic() - start_s < 2.0
    for _, connection in held:
        connection.close()
