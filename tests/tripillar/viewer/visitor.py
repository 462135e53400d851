"""Someone who asks the page's server: by requests, as a browser, or by bytes written by hand."""

import asyncio
import json
import struct
from contextlib import asynccontextmanager, suppress

import aiohttp
import psutil

from tests.house import PATIENT_S


class Visitor:
    """Someone who has a page's address with its token."""

    def __init__(self, url):
        self.base, self.token = url.split("?token=")
        self.netloc = self.base.removeprefix("http://").rstrip("/")
        self.port = int(self.netloc.rsplit(":", 1)[1])
        self.own = {"Host": self.netloc, "Origin": f"http://{self.netloc}", "Cookie": self.cookie(self.token)}

    def cookie(self, token):
        return f"tripillar_{self.port}={token}"

    async def get(self, path, base="", **headers):
        """Status, headers and text of an answer."""
        async with aiohttp.ClientSession() as client, client.get((base or self.base) + path, headers=headers) as answer:
            return answer.status, answer.headers, await answer.text()

    async def asked_for_socket(self, **changed):
        """The status that a request for the web socket gets, its headers but for some as the page sends them."""
        said = {name: value for name, value in (self.own | changed).items() if value is not None}
        async with aiohttp.ClientSession() as client:
            try:
                async with client.ws_connect(self.base + "socket", headers=said):
                    return 101
            except aiohttp.WSServerHandshakeError as error:
                return error.status

    @asynccontextmanager
    async def browser(self, is_served=True):
        """A browser that has the page."""
        async with (
            aiohttp.ClientSession() as client,
            client.ws_connect(self.base + "socket", headers=self.own) as socket,
        ):
            browser = Browser(socket)
            if is_served:
                await browser.heard("show")
            yield browser

    async def wait_for_a_place(self):
        """Wait until the server has seen that another browser left."""
        async with asyncio.timeout(PATIENT_S):
            while True:
                with suppress(ConnectionResetError):
                    async with self.browser():
                        return
                await asyncio.sleep(0.1)

    async def raw(self, head):
        """A connection with a request whose headers are the page's, written by hand."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        words = "".join(f"{name}: {value}\r\n" for name, value in self.own.items())
        writer.write(head.replace("\r\n", f"\r\n{words}", 1).encode())
        return reader, writer

    async def raw_socket(self):
        """A web socket whose frames are written by hand."""
        reader, writer = await self.raw(
            "GET /socket HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        assert b" 101 " in await reader.readuntil(b"\r\n\r\n")
        return reader, writer


class Browser:
    """The page's side of the web socket."""

    def __init__(self, socket):
        self.socket, self.shown, self.controls = socket, {}, {}

    async def say(self, **message):
        await self.socket.send_str(json.dumps(message))

    async def change(self, **message):
        """Say something; what is shown then."""
        await self.say(**message)
        return await self.heard("show")

    async def load_by_pads(self):
        """Take the load off and let pads be pressed one by one; the page opens under an indenter."""
        await self.change(do="reset")
        self.controls["source"] = "pads"
        await self.change(set={"source": "pads"})

    async def heard(self, kind):
        """The next message of a kind, or picture; all are taken note of."""
        async with asyncio.timeout(PATIENT_S):
            async for message in self.socket:
                is_picture = message.type is aiohttp.WSMsgType.BINARY
                said = {"picture": message.data} if is_picture else json.loads(message.data)
                self.shown |= said.get("show", {})
                self.controls |= said.get("show", {}).get("controls", {})
                if kind in said:
                    return said[kind]
        raise ConnectionResetError(f"closed with {self.socket.close_code}")


async def rest(reader):
    """All that comes until the connection ends."""
    said = b""
    with suppress(ConnectionResetError):  # of what was not read
        async with asyncio.timeout(PATIENT_S):
            while part := await reader.read(2**16):
                said += part
    return said


def memory_mb():
    return psutil.Process().memory_info().rss / 1e6


def frame(opcode, length, content, fin=True):
    """A masked frame that claims a length, whatever it has."""
    size = length if length < 126 else 126 if length < 2**16 else 127
    claimed = {126: struct.pack(">H", length & 0xFFFF), 127: struct.pack(">Q", length)}.get(size, b"")
    return bytes([opcode | (0x80 if fin else 0), 0x80 | size]) + claimed + b"\0\0\0\0" + content
