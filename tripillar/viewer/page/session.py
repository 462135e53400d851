"""One browser at the page: its messages are checked and done, and what has changed is sent back."""

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from typing import Any

from aiohttp import WSMsgType, web

from tripillar.viewer.page.controls import ControlError, mapping, numbers_of, shortened
from tripillar.viewer.page.page import Page

MAX_A_SECOND = 200  #: messages that are read; a screen gives 60 moves of the mouse
BURST_S = 1.0  #: worth of messages that are read at once after a silence
MAX_PIXELS_A_SIDE = 4096
TURN_DEG, NEARER, MOVED = 360.0, (0.1, 10.0), 5.0  #: bounds of one gesture


class Session:
    """A page and the web socket of the browser that shows it.

    Messages are JSON objects, usually of one name. From the browser: "set" {control: value}, "do" one of `calls`,
    "turn" [right, up] in degrees, "nearer" factor, "move" [right, up] in pictures' heights, "size" [wide, high] in
    pixels, "restore", a state, and "file", csv or scene. To it: "facts", "show" with what has changed, "file" with
    "name" and "text", and "refused" with the reason. Pictures are the binary messages.
    """

    def __init__(self, page: Page, socket: web.WebSocketResponse) -> None:
        self._page, self._socket = page, socket
        self._shown: dict[str, Any] = {}  # as the browser has it
        self._files: list[dict[str, str]] = []  # asked for and not sent yet
        self.calls: dict[str, Callable[[], None]] = {
            "reset": page.reset,
            "home": page.look_from_the_start,
            "again": page.play_again,
        }
        camera = page.scene.camera
        self._takers: dict[str, Callable[[Any], None]] = {
            "set": self._set,
            "do": self._do,
            "turn": lambda said: camera.turn(*numbers_of("turn", said, 2, -TURN_DEG, TURN_DEG)),
            "nearer": lambda said: camera.approach(*numbers_of("nearer", [said], 1, *NEARER)),
            "move": lambda said: camera.move(*numbers_of("move", said, 2, -MOVED, MOVED)),
            "size": self._resize,
            "restore": page.restore,
            "file": lambda said: self._files.append(page.file(said)),
        }

    async def run(self) -> None:
        """Listen, tell and draw until the browser leaves."""
        await self._send({"facts": self._page.facts()})
        working = [
            asyncio.create_task(work)
            for work in (
                self._tell(), self._page.pictures.run(self._socket.send_bytes), self._page.solve(), self._listen()
            )
        ]  # fmt: skip
        try:
            await asyncio.wait(working, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in working:
                task.cancel()
            ended = await asyncio.gather(*working, return_exceptions=True)
        for error in ended:
            if isinstance(error, Exception) and not isinstance(error, ConnectionResetError):  # it left meanwhile
                raise error

    async def _listen(self) -> None:
        """Do what the browser's messages say, until it leaves."""
        next_s = 0.0
        async for message in self._socket:
            try:
                if message.type is WSMsgType.PING:
                    await self._socket.pong(message.data)
                elif message.type is WSMsgType.TEXT:
                    self._take(message.data)
                    while self._files:
                        await self._send({"file": self._files.pop()})
                elif message.type is not WSMsgType.PONG:
                    raise ControlError("messages are text.")
            except ControlError as error:
                await self._send({"refused": str(error)})
            now_s = time.monotonic()
            next_s = max(next_s, now_s - BURST_S) + 1.0 / MAX_A_SECOND
            await asyncio.sleep(max(next_s - now_s, 0.0))  # others have their turn, and a flood waits in its sender

    def _take(self, text: str) -> None:
        """Do what a message says; ControlError if it is none of those that `Session` names."""
        try:
            said = json.loads(text)
        except (ValueError, RecursionError):
            raise ControlError("a message is no JSON.") from None
        for name, value in mapping("a message", said).items():
            if name not in self._takers:
                raise ControlError(f"there is no message {shortened(name)}.")
            self._takers[name](value)
            if name in ("turn", "nearer", "move"):
                self._page.pictures.schedule_render()

    def _set(self, said: Any) -> None:
        self._page.set(said)
        self._shown.setdefault("controls", {}).update(said)

    def _do(self, said: Any) -> None:
        if not isinstance(said, str) or said not in self.calls:
            raise ControlError(f"do={shortened(said)} is none of {', '.join(self.calls)}.")
        self.calls[said]()

    def _resize(self, said: Any) -> None:
        wide, high = numbers_of("size", said, 2, 1.0, MAX_PIXELS_A_SIDE)
        self._page.pictures.resize(round(wide), round(high))

    async def _tell(self) -> None:
        """Send what has changed whenever something has, until cancelled."""
        while True:
            await self._page.is_changed.wait()
            self._page.is_changed.clear()
            shown = self._page.update() | {"controls": dict(self._page.controls)}
            changed = news(self._shown, shown)
            changed["controls"] = news(self._shown.get("controls", {}), shown["controls"])
            self._shown |= shown
            await self._send({"show": changed})

    async def _send(self, message: Mapping[str, Any]) -> None:
        await self._socket.send_str(json.dumps(message, allow_nan=False))


def news(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """The items of `new` that `old` lacks or has otherwise.

    >>> news({"a": 1, "b": 2}, {"a": 1, "b": 3})
    {'b': 3}
    """
    return {name: value for name, value in new.items() if name not in old or old[name] != value}
