"""A server of Foxglove's WebSocket protocol that knows whom it lets in, and how much waits for the slow ones.

It follows https://github.com/foxglove/ws-protocol: channels are advertised to each client, which subscribes to some.
Needs the package ``websockets``.
"""

import base64
import contextlib
import http
import json
import logging
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Mapping
from hmac import compare_digest
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, urlsplit

from hardware.recording.mcap_file import Channel
from hardware.streams.addresses import StreamError, is_loopback

SUBPROTOCOLS: list[Any] = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
TRUSTED_SITES = ("foxglove.dev",)  #: whose pages may connect, and those of this machine
MAX_CLIENTS = 8
MAX_WAITING = 256  #: messages that wait for a client; the oldest are dropped. Clients share their bytes.
MAX_TOLD = 2**16  #: bytes of what a client says at once
CLOSING_S = 0.5  #: longest time for all clients to read what waits for them at the end
HANDSHAKE_S = 3.0  #: longest time to say who one is
_MESSAGE = struct.Struct("<BIQ")  # 1, subscription, time [ns]


class FoxgloveServer:
    """Serves messages of channels {topic: channel} to clients, each in two threads of its own, until closed.

    Parameters
    ----------
    channels : mapping
    host, port : str, int
        To listen on; port 0: one that is free.
    token : str
        With one, a client must name it as ``ws://host:port/?token=...``. Without one, pages in a browser are let in by
        their origin: those of this machine and of `TRUSTED_SITES`; and the address must be asked for as numbers or as
        localhost, so that no other name can be pointed at it.
    latched : str
        Topic whose last message whoever subscribes gets at once.

    Raises
    ------
    StreamError
        If the port cannot be had.
    """

    def __init__(self, channels: Mapping[str, Channel], host: str, port: int, token: str, latched: str) -> None:
        from websockets.sync.server import serve

        self._numbers = {topic: k for k, topic in enumerate(channels, start=1)}
        self._host, self._token, self._latched = host, token, self._numbers[latched]
        self._kept: tuple[int, bytes] | None = None  # the last message of the latched topic
        self._clients: set[_Client] = set()
        self._lock = threading.Lock()
        advertised = [
            {"id": self._numbers[topic], "topic": topic, "encoding": channel.encodings[0], "schema": _text(channel)}
            | {"schemaName": channel.schema, "schemaEncoding": channel.encodings[1]}
            for topic, channel in channels.items()
        ]
        about = {"op": "serverInfo", "name": "TriPillar", "capabilities": [], "supportedEncodings": [], "metadata": {}}
        self._greeting = [json.dumps(about), json.dumps({"op": "advertise", "channels": advertised})]
        try:
            self._server = serve(
                self._attend, host, port, process_request=self._refusal, subprotocols=SUBPROTOCOLS,
                compression=None, max_size=MAX_TOLD, open_timeout=HANDSHAKE_S, close_timeout=1.0, logger=_silent(),
            )  # fmt: skip
        except OSError as error:
            raise StreamError(f"{host}:{port}: {error.strerror}: give another address.") from None
        self.port: int = self._server.socket.getsockname()[1]  #: that it listens on
        self._thread = threading.Thread(target=self._server.serve_forever, name="foxglove", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send all away and listen no more; who has not read what waits within `CLOSING_S` is cut off."""
        clients, end_s = list(self._clients), time.monotonic() + CLOSING_S
        for client in clients:
            client.finish()
        for client in clients:
            client.cut_after(max(0.0, end_s - time.monotonic()))
        self._server.shutdown()  # waits for each client that is still connected
        self._thread.join()

    def has_listeners(self, topic: str) -> bool:
        """Whether a client subscribes to a topic."""
        return any(self._numbers[topic] in client.subscribed for client in list(self._clients))

    def send(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Give a message to all who subscribe to its topic; waits for nobody."""
        channel = self._numbers[topic]
        if channel == self._latched:
            self._kept = stamp_ns, data
        for client in list(self._clients):
            client.put(channel, stamp_ns, data)

    def _refusal(self, connection: Any, request: Any) -> Any:
        """The answer to a client that is not let in; None to one that is."""
        said = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if self._token:
            is_known = compare_digest(said.encode(), self._token.encode())
        else:
            origins = [urlsplit(origin) for origin in request.headers.get_all("Origin")]
            is_known = all(map(_is_trusted, origins)) and _is_number(request.headers.get("Host", ""), self._host)
        if not is_known:
            return connection.respond(http.HTTPStatus.FORBIDDEN, "not let in: by origin, host or token\n")
        if len(self._clients) >= MAX_CLIENTS:
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_CLIENTS} clients are enough\n")
        return None

    def _attend(self, connection: Any) -> None:
        """Talk to one client until it goes."""
        from websockets.exceptions import ConnectionClosed

        client = _Client(connection)
        with self._lock:
            if len(self._clients) >= MAX_CLIENTS:  # others came at the same moment
                return
            self._clients.add(client)
        sender = threading.Thread(target=client.run, name="foxglove client", daemon=True)
        try:
            for text in self._greeting:
                connection.send(text)
            sender.start()
            for told in connection:
                for channel in client.hear(told, set(self._numbers.values())):
                    if channel == self._latched and self._kept:
                        client.put(channel, *self._kept)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)
            client.end()


class _Client:
    """One client: what it subscribes to, and what waits for it."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self.subscribed: dict[int, int] = {}  # channel: its subscription
        self._waiting: deque[tuple[int, int, bytes]] = deque(maxlen=MAX_WAITING)
        self._changed = threading.Condition()
        self._is_over = False
        self._has_sent = threading.Event()  # all that it will be sent

    def hear(self, told: str | bytes, channels: set[int]) -> list[int]:
        """The channels that a message from the client subscribes to anew; nonsense is passed over."""
        try:
            said = json.loads(told)
            if said["op"] == "unsubscribe":
                gone = set(said["subscriptionIds"])
                self.subscribed = {channel: each for channel, each in self.subscribed.items() if each not in gone}
            elif said["op"] == "subscribe":
                asked = {int(each["channelId"]): int(each["id"]) for each in said["subscriptions"]}
                new = {channel: each % 2**32 for channel, each in asked.items() if channel in channels}
                self.subscribed = self.subscribed | new
                return list(new)
        except (ValueError, TypeError, KeyError):
            pass
        return []

    def put(self, channel: int, stamp_ns: int, data: bytes) -> None:
        """Have a message sent, if the client subscribes to it."""
        if channel in self.subscribed:
            with self._changed:
                self._waiting.append((channel, stamp_ns, data))
                self._changed.notify()

    def run(self) -> None:
        """Send what waits, until the end."""
        from websockets.exceptions import ConnectionClosed

        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting or self._is_over)
                    if not self._waiting:
                        return
                    channel, stamp_ns, data = self._waiting.popleft()
                number = self.subscribed.get(channel)
                if number is not None:
                    self._connection.send(_MESSAGE.pack(1, number, stamp_ns) + data)
        except ConnectionClosed:
            pass
        finally:
            self._has_sent.set()

    def finish(self) -> None:
        """Take no more than what waits."""
        with self._changed:
            self._is_over = True
            self._changed.notify()

    def cut_after(self, seconds: float) -> None:
        """Cut the connection if what waits is not sent by then: a send that waits for the client would never end."""
        if not self._has_sent.wait(seconds):
            with contextlib.suppress(OSError):  # it has gone meanwhile
                self._connection.socket.shutdown(socket.SHUT_RDWR)

    def end(self) -> None:
        """Close the connection, with what waits unsent where the client does not read."""
        self.finish()
        threading.Thread(target=self._connection.close, daemon=True).start()


def _silent() -> logging.Logger:
    """A logger that says nothing: the terminal is not for what strangers send."""
    logger = logging.getLogger("tripillar.foxglove")
    logger.propagate, logger.handlers = False, [logging.NullHandler()]
    return logger


def _is_trusted(origin: Any) -> bool:
    """Whether a page of this origin may connect; a file's and a program's own have no host."""
    host = origin.hostname or ""
    return not host or is_loopback(host) or any(host == site or host.endswith(f".{site}") for site in TRUSTED_SITES)


def _is_number(asked: str, host: str) -> bool:
    """Whether a Host header names this machine by numbers, as localhost, or as it was told to listen."""
    name = urlsplit(f"//{asked}").hostname or ""
    try:
        ip_address(name)
    except ValueError:
        return name in ("localhost", host)
    return True


def _text(channel: Channel) -> str:
    """The definition of a channel's messages, as it is advertised."""
    return channel.text if isinstance(channel.text, str) else base64.b64encode(channel.text).decode()
