"""Foxglove's stream as a WebSocket client of its protocol sees it, which knows no more than the server advertises."""

import asyncio
import json
import socket
import struct
import sys
import threading
import time

import numpy as np
import pytest

from geometry.errors import DesignError, MissingPackageError
from hardware.readout.wrench import SIGNS
from hardware.recording.topics import FORCES, RESISTANCES, SENSOR, WRENCH
from hardware.streams.addresses import ROOM_BYTES, StreamError, make_file
from hardware.streams.foxglove_server import MAX_CLIENTS, MAX_WAITING
from hardware.streams.foxglove_stream import SCENE, FoxgloveStream
from hardware.streams.rerun_stream import RerunStream
from hardware.streams.scene import LONGEST, Painter
from tests.hardware.recording.test_failures import room_for

pytest.importorskip("foxglove")
websockets = pytest.importorskip("websockets")
protobuf = pytest.importorskip("google.protobuf")


class Client:
    """Subscribes to all that is advertised; `channels` by topic, and `messages` by topic: [(log time, bytes)]."""

    def __init__(self, port):
        self.channels, self.messages = {}, {}
        self._url = f"ws://127.0.0.1:{port}"
        self._thread = threading.Thread(target=lambda: asyncio.run(self._listen()))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._thread.join(10)  # the server has gone: the connection is closed

    def wait_for(self, is_so):
        end_s = time.monotonic() + 10
        while not is_so():
            assert time.monotonic() < end_s, {topic: len(found) for topic, found in self.messages.items()}
            time.sleep(0.005)

    async def _listen(self):
        async with websockets.connect(self._url, subprotocols=["foxglove.sdk.v1"], max_size=None) as connection:
            topics = {}
            async for message in connection:
                if isinstance(message, bytes) and message[0] == 1:  # a message of a subscribed channel
                    subscription, log_ns = struct.unpack_from("<IQ", message, 1)
                    self.messages.setdefault(topics[subscription], []).append((log_ns, message[13:]))
                elif isinstance(message, str) and (told := json.loads(message))["op"] == "advertise":
                    for channel in told["channels"]:
                        topics[channel["id"]] = channel["topic"]
                        self.channels[channel["topic"]] = channel
                    asked = [{"id": channel["id"], "channelId": channel["id"]} for channel in told["channels"]]
                    await connection.send(json.dumps({"op": "subscribe", "subscriptions": asked}))


def decoder(channel):
    """The message class of a Protobuf channel, made of the schema that the server advertises."""
    from base64 import b64decode

    from google.protobuf import descriptor_pool, message_factory
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(b64decode(channel["schema"])).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


def along_x(pose):
    """The direction of a pose's x axis."""
    q = pose.orientation
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])


@pytest.fixture
def received(board):
    """30 frames of a simulated board, and the client that received them."""
    with FoxgloveStream(board.description, port=0) as stream, Client(stream.port) as client:
        sent = []
        client.wait_for(lambda: len(client.channels) == 6)
        client.wait_for(lambda: [stream.add(frame) for frame in board.take(1)] and SENSOR in client.messages)
        client.wait_for(lambda: SCENE in client.messages)
        for frame in board.take(30):
            stream.add(frame)
            sent.append(frame)
        last = sent[-1].stamp_ns
        every = (FORCES, WRENCH, RESISTANCES, SCENE)
        client.wait_for(lambda: all(client.messages[topic][-1][0] == last for topic in every))
        stream.__exit__(None, None, None)
    return board.description, sent, client


def test_a_client_decodes_what_was_sent(received):
    """Forces, net load and resistances as JSON, the picture as Protobuf; at the stamps of the board's clock."""
    description, sent, client = received
    assert json.loads(client.messages[SENSOR][0][1]) == description.plain()
    stamps = [frame.stamp_ns for frame in sent]
    newest = {topic: found[-30:] for topic, found in client.messages.items()}
    assert np.diff(stamps).min() > 0
    for topic in (FORCES, WRENCH, RESISTANCES, SCENE):
        assert [log_ns for log_ns, _ in newest[topic]] == stamps
    for k, frame in enumerate(sent):
        forces, net, ohms = (json.loads(newest[topic][k][1]) for topic in (FORCES, WRENCH, RESISTANCES))
        found = np.array([unit["force_n"] for unit in forces["units"]])
        assert found == pytest.approx(frame.force_n.reshape(-1, 3), abs=1e-6)
        assert np.array([unit["deviation_n"] for unit in forces["units"]]).min() > 0
        assert net["net_force_n"] == pytest.approx(frame.wrench.force_n, rel=1e-5)
        assert net["centre_of_pressure_mm"] == pytest.approx(frame.wrench.centre_mm, rel=1e-5)
        found = np.array([unit["resistance_ohm"] for unit in ohms["units"]])
        assert found == pytest.approx(frame.resistance_ohm.reshape(-1, 3), abs=1e-3)


def test_arrows_are_the_forces_on_the_pads(received):
    """Each ends at its pad and points along the force; lengths are in proportion. The last one is the net force."""
    description, sent, client = received
    scene = decoder(client.channels[SCENE])
    pads_m, painter = description.position_m.reshape(-1, 3), Painter(description)
    per_newton = LONGEST * painter.pad_m / painter.full_scale_n
    for (_, data), frame in zip(client.messages[SCENE][-30:], sent, strict=True):
        [entity] = scene.FromString(data).entities
        assert entity.frame_id == "tripillar"
        assert entity.timestamp.ToNanoseconds() == frame.stamp_ns
        assert len(entity.cubes) == 6
        *arrows, net = entity.arrows
        ends, forces = [], []
        for arrow in (*arrows, net):
            vector = (arrow.shaft_length + arrow.head_length) * along_x(arrow.pose)
            position = arrow.pose.position
            ends.append(vector + np.array([position.x, position.y, position.z]))
            forces.append(vector / per_newton)
        assert len(arrows) == 6  # every pad is pressed well
        assert np.array(ends[:-1]) == pytest.approx(pads_m, abs=1e-9)
        assert np.array(forces[:-1]) == pytest.approx(frame.force_n.reshape(-1, 3) * SIGNS, abs=1e-6)
        assert ends[-1] == pytest.approx([*1e-3 * frame.wrench.centre_mm, 0.0], abs=1e-9)
        assert 6**0.5 * forces[-1] == pytest.approx(frame.wrench.vector_n, abs=1e-6)


def test_the_file_holds_what_the_stream_would(board, tmp_path):
    """Read by any MCAP reader; the description first, and once."""
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "shown.mcap"
    with FoxgloveStream(board.description, host=None, mcap=path) as stream:
        for frame in (sent := board.take(5)):
            stream.add(frame)
    with path.open("rb") as file:
        found = [(c.topic, m.log_time) for _, c, m in reader.make_reader(file).iter_messages(log_time_order=False)]
    stamps = [frame.stamp_ns for frame in sent]
    for topic in (FORCES, WRENCH, RESISTANCES, SCENE):
        assert [log_ns for name, log_ns in found if name == topic] == stamps
    assert found[0] == (SENSOR, stamps[0])
    assert [name for name, _ in found].count(SENSOR) == 1
    before = path.read_bytes()
    with pytest.raises(StreamError, match="exists: give another name"), FoxgloveStream(board.description, mcap=path):
        pass
    assert path.read_bytes() == before


def test_a_port_that_is_taken_is_refused_and_leaves_no_file(board, tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = FoxgloveStream(board.description, port=other.getsockname()[1], mcap=tmp_path / "never.mcap")
        with pytest.raises(StreamError, match="give another address"), taken:
            pass
    assert not (tmp_path / "never.mcap").exists()


@pytest.mark.parametrize(("package", "stream"), [("foxglove", FoxgloveStream), ("rerun", RerunStream)])
def test_a_missing_package_is_named_with_its_extra(board, monkeypatch, package, stream):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackageError, match=rf"pip install 'tripillar\[{package}\]'"):
        stream(board.description)


def test_a_sensor_of_unknown_pads_is_refused(board):
    unknown = vars(board.description) | {"position_mm": np.full((2, 3, 3), np.nan)}
    with pytest.raises(DesignError, match="model states no design"):
        FoxgloveStream(type(board.description)(**unknown))


def handshake(port, path="/", **headers):
    """The HTTP status that a client gets."""
    asked = {
        "Host": f"127.0.0.1:{port}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
    }
    asked |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "foxglove.sdk.v1"} | headers
    connection = socket.create_connection(("127.0.0.1", port), timeout=10)
    lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in asked.items()), "", ""]
    connection.sendall("\r\n".join(lines).encode())
    return int(connection.recv(4096).split()[1]), connection


@pytest.mark.parametrize(
    ("token", "path", "headers", "status"),
    [
        ("", "/", {}, 101),
        ("", "/", {"Origin": "https://app.foxglove.dev"}, 101),
        ("", "/", {"Origin": "http://localhost:8080"}, 101),
        ("", "/", {"Origin": "file://"}, 101),
        ("", "/", {"Origin": "https://evil.example"}, 403),
        ("", "/", {"Origin": "https://foxglove.dev.evil.example"}, 403),
        ("", "/", {"Host": "evil.example:8765"}, 403),  # a name that was pointed at this machine
        ("secret", "/", {}, 403),
        ("secret", "/?token=secre", {}, 403),
        ("secret", "/?token=secret", {"Origin": "https://mine.example"}, 101),
    ],
)
def test_only_known_pages_or_a_token_are_let_in(board, token, path, headers, status):
    with FoxgloveStream(board.description, port=0, token=token) as stream:
        found, connection = handshake(stream.port, path, **headers)
        connection.close()
    assert found == status


def test_a_client_that_talks_nonsense_is_sent_away_without_a_word(board, capfd):
    with FoxgloveStream(board.description, port=0) as stream:
        for said in (b"\0\0\0", b"GET / HTTP/1.1\r\n\r\n", b"POST / HTTP/1.1\r\nHost: a\r\n\r\n", b""):
            with socket.create_connection(("127.0.0.1", stream.port), timeout=10) as connection:
                connection.sendall(said)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):
                    pass
    assert capfd.readouterr() == ("", "")


def test_clients_and_what_waits_for_them_are_bounded(board):
    """Who never reads costs no more than the newest messages, which all share, and the end waits for none of them."""
    [scan] = board.take(1)
    with FoxgloveStream(board.description, port=0) as stream:
        held = [handshake(stream.port) for _ in range(MAX_CLIENTS)]
        assert [status for status, _ in held] == [101] * MAX_CLIENTS
        server = stream._server
        end_s = time.monotonic() + 10
        while len(server._clients) < MAX_CLIENTS and time.monotonic() < end_s:
            time.sleep(0.005)
        held.append(handshake(stream.port))
        assert held[-1][0] == 503
        for client in server._clients:
            client.hear(
                json.dumps({"op": "subscribe", "subscriptions": [{"id": k, "channelId": k} for k in range(9)]}), {2}
            )
            for nonsense in ("{", "[]", '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [{}]}', b"\xff"):
                assert client.hear(nonsense, {2}) == []
            assert client.subscribed == {2: 2}
        stream.add(scan)
        for k in range(4 * MAX_WAITING):
            server.send(FORCES, k, bytes(100_000))  # more than the system takes for those who do not read
        waiting = [client._waiting for client in server._clients]
        assert any(len(each) == MAX_WAITING for each in waiting)
        assert all(len(each) <= MAX_WAITING for each in waiting)
        assert len({id(data) for each in waiting for _, _, data in each}) <= MAX_WAITING + 1
        held[0][1].close()
        while len(server._clients) == MAX_CLIENTS and time.monotonic() < end_s:
            time.sleep(0.005)
        held.append(handshake(stream.port))
        assert held[-1][0] == 101  # there is room again
    for _, connection in held:
        connection.close()


def test_a_full_disk_ends_the_file_and_all_of_it_is_read(board, tmp_path):
    """A limit on the size of files stands for the disk."""
    reader, path = pytest.importorskip("mcap.reader"), tmp_path / "shown.mcap"
    [scan] = board.take(1)
    n = 0

    def add_until_full():
        nonlocal n
        while n < 20_000:
            stream.add(scan)
            n += 1

    full = pytest.raises(StreamError, match=r"shown.mcap: the disk is full \(.*the file ends here and can be read")
    with room_for(ROOM_BYTES + 100_000), full, FoxgloveStream(board.description, host=None, mcap=path) as stream:
        add_until_full()
    with room_for(10_000), pytest.raises(StreamError, match="the disk is full"):
        make_file(tmp_path / "other.mcap")
    with path.open("rb") as file:
        found = reader.make_reader(file, validate_crcs=True)
        assert found.get_summary().statistics.message_count == 1 + 4 * (n + 1)
        assert sum(1 for _ in found.iter_messages()) == 1 + 4 * (n + 1)
    assert [each.name for each in tmp_path.iterdir()] == ["shown.mcap"]
