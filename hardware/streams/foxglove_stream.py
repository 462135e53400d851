"""Forces for Foxglove: a WebSocket server that knows whom it lets in, and how much waits for the slow ones.

It follows https://github.com/foxglove/ws-protocol: channels are advertised to each client, which subscribes to some.
Needs the extra ``foxglove``.
"""

import asyncio
import http
import json
import logging
import re
import socket
import struct
import threading
from contextlib import suppress
from hmac import compare_digest
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

from common.errors import needing
from hardware.readout.description import SensorDescription
from hardware.readout.forces import Forces
from hardware.streams.stream import LOOPBACK, listening_on
from hardware.streams.topics import CONTACTS, CONTENTS, SENSOR, json_bytes, schemas

PORT = 8765  #: where Foxglove looks for a server
SUBPROTOCOLS: list[Any] = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
#: origins of pages that may connect: of this machine, of Foxglove, and of files and programs, which have no host
TRUSTED = re.compile(r"\w+://((localhost|127\.0\.0\.1|\[::1\]|([\w-]+\.)*foxglove\.dev)(:\d+)?)?")
NUMBERS = re.compile(r"localhost|[\d.]+|[\da-f:.]*:[\da-f:.]*")  #: hosts that no other name can be pointed at
MAX_CLIENTS = 8
MAX_WAITING = 2**22  #: bytes that wait for a client; where more do, it gets no new messages
MAX_MESSAGE = 2**16  #: bytes of what a client says at once
CLOSING_S = 0.5  #: longest time for all clients to read what waits for them at the end
HANDSHAKE_S = 3.0  #: longest time to say who one is
_MESSAGE = struct.Struct("<BIQ")  # 1, subscription, time [ns]


class FoxgloveStream:
    """Sends the forces of scans as JSON to all who are connected, as long as the with block lasts; waits for nobody.

    A topic that nobody listens to is not made. The description is sent at the beginning, and again to whoever
    subscribes to it later. Port 0 is one that is free. With a token, a client must name it as
    ``ws://host:port/?token=...``. Without one, pages in a browser are let in by their origin, `TRUSTED`, and the
    address must be asked for as numbers or as localhost, so that no other name can be pointed at it. At the end, who
    has not read what waits within `CLOSING_S` is cut off. All else is as of `Stream`.
    """

    def __init__(self, sensor: SensorDescription, host: str = LOOPBACK, port: int = PORT, token: str = "") -> None:
        with needing("Foxglove", "foxglove"):
            import websockets  # noqa: F401
        sensor.require_positions()
        self._sensor, self._host, self.port, self._token = sensor, host, port, token
        stated = schemas()
        self._numbers = {topic: k for k, topic in enumerate(stated, start=1)}
        self._is_first = True
        self._described: tuple[int, bytes] | None = None  # the last message of the sensor
        self._clients: dict[Any, dict[int, int]] = {}  # of each connection the subscription to a channel
        self._greeting = [
            {"op": "serverInfo", "name": "TriPillar", "capabilities": [], "supportedEncodings": [], "metadata": {}},
            {"op": "advertise", "channels": [
                {"id": self._numbers[topic], "topic": topic, "encoding": "json", "schemaEncoding": "jsonschema"}
                | {"schemaName": schema["title"], "schema": json.dumps(schema)}
                for topic, schema in stated.items()
            ]},
        ]  # fmt: skip

    def __enter__(self) -> Self:
        listening, began = listening_on(self._host, self.port), threading.Event()
        self.port = listening.getsockname()[1]
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(listening, began)), daemon=True)
        self._thread.start()
        began.wait()
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(RuntimeError):  # it has ended before
            self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join()

    def add(self, scan: Forces) -> None:
        """Send the forces of one scan."""
        stamp_ns = int(scan.stamp_ns)
        if self._is_first:
            self._is_first = False
            self.send(SENSOR, stamp_ns, json_bytes(self._sensor.plain()))
        for topic, content in CONTENTS.items():
            is_there = topic != CONTACTS or scan.contacts is not None
            if is_there and self.has_listeners(topic):
                self.send(topic, stamp_ns, json_bytes(content(scan)))

    def has_listeners(self, topic: str) -> bool:
        """Whether a client subscribes to a topic."""
        return any(self._numbers[topic] in subscribed for subscribed in list(self._clients.values()))

    def send(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Give a message to all who subscribe to its topic."""

        def give_all() -> None:
            if topic == SENSOR:
                self._described = stamp_ns, data
            for client in self._clients:
                self._give(client, self._numbers[topic], stamp_ns, data)

        self._loop.call_soon_threadsafe(give_all)

    def _give(self, client: Any, channel: int, stamp_ns: int, data: bytes) -> None:
        from websockets.asyncio.server import broadcast

        number = self._clients[client].get(channel)
        if number is not None and client.transport.get_write_buffer_size() < MAX_WAITING:
            broadcast([client], _MESSAGE.pack(1, number, stamp_ns) + data)

    async def _serve(self, listening: socket.socket, began: threading.Event) -> None:
        from websockets.asyncio.server import serve

        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        began.set()
        silent = logging.Logger("foxglove", logging.CRITICAL + 1)  # the terminal is not for what strangers send
        server = await serve(
            self._attend, sock=listening, process_request=self._refusal, subprotocols=SUBPROTOCOLS, compression=None,
            max_size=MAX_MESSAGE, open_timeout=HANDSHAKE_S, close_timeout=CLOSING_S, logger=silent,
        )  # fmt: skip
        await self._over.wait()
        server.close()
        with suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), CLOSING_S)
        for client in self._clients:
            client.transport.abort()

    def _refusal(self, connection: Any, request: Any) -> Any:
        """The answer to a client that is not let in; None to one that is."""
        if self._token:
            token = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
            is_known = compare_digest(token.encode(), self._token.encode())
        else:
            origins = request.headers.get_all("Origin")
            asked = urlsplit(f"//{request.headers.get('Host', '')}").hostname or ""
            is_named = NUMBERS.fullmatch(asked) or asked == self._host
            is_known = bool(is_named) and all(map(TRUSTED.fullmatch, origins))
        if not is_known:
            return connection.respond(http.HTTPStatus.FORBIDDEN, "not let in: by origin, host or token\n")
        if len(self._clients) >= MAX_CLIENTS:
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_CLIENTS} clients are enough\n")
        return None

    async def _attend(self, client: Any) -> None:
        """Talk to one client until it goes."""
        from websockets.exceptions import ConnectionClosed

        if len(self._clients) >= MAX_CLIENTS:  # others came at the same moment
            return
        subscribed = self._clients[client] = {}
        try:
            for greeting in self._greeting:
                await client.send(json.dumps(greeting))
            async for message in client:
                for channel in _subscribed(message, subscribed, set(self._numbers.values())):
                    if channel == self._numbers[SENSOR] and self._described:
                        self._give(client, channel, *self._described)
        except ConnectionClosed:
            pass
        finally:
            del self._clients[client]


def _subscribed(message: str | bytes, subscribed: dict[int, int], channels: set[int]) -> list[int]:
    """Keep what a client subscribes to, and say to which channels anew; nonsense is passed over."""
    try:
        request = json.loads(message)
        if request["op"] == "unsubscribe":
            gone = set(request["subscriptionIds"])
            for channel in [channel for channel, number in subscribed.items() if number in gone]:
                del subscribed[channel]
        elif request["op"] == "subscribe":
            asked = {int(each["channelId"]): int(each["id"]) % 2**32 for each in request["subscriptions"]}
            new = {channel: number for channel, number in asked.items() if channel in channels}
            subscribed.update(new)
            return list(new)
    except (ValueError, TypeError, KeyError):
        pass
    return []
