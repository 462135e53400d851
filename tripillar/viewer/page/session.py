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

    Messages are JSON objects, usually of one name. From the browser: "set" {control: value}, "do" one of `Page.calls`,
    "turn" [right, up] in degrees, "nearer" factor, "move" [right, up] in pictures' heights, "size" [wide, high] in
    pixels, "restore", a state, and "file", csv or scene. To it: "facts", "show" with what has changed, "file" with
    "name" and "text", and "refused" with the reason. Pictures are the binary messages.
    """

    def __init__(self, page: Page, socket: web.WebSocketResponse) -> None:
        self._page, self._socket = page, socket
        self._shown: dict[str, Any] = {"controls": {}}  # as the browser has it
        camera, pictures = page.scene.camera, page.pictures
        self._takers: dict[str, Callable[[Any], Any]] = {
            "set": self._set,
            "do": page.do,
            "turn": lambda said: camera.turn(*numbers_of("turn", said, 2, -TURN_DEG, TURN_DEG)),
            "nearer": lambda said: camera.approach(*numbers_of("nearer", [said], 1, *NEARER)),
            "move": lambda said: camera.move(*numbers_of("move", said, 2, -MOVED, MOVED)),
            "size": lambda said: pictures.resize(*numbers_of("size", said, 2, 1.0, MAX_PIXELS_A_SIDE)),
            "restore": page.restore,
            "file": page.file,
        }

    async def run(self) -> None:
        """Listen, tell and draw until the browser leaves."""
        try:
            await self._send({"facts": self._page.facts()})
            async with asyncio.TaskGroup() as group:
                work = self._tell(), self._page.pictures.run(self._socket.send_bytes), self._page.solve()
                working = [group.create_task(one) for one in work]
                await self._listen()
                for task in working:
                    task.cancel()
        except* ConnectionResetError:  # it left meanwhile
            pass

    async def _listen(self) -> None:
        """Do what the browser's messages say, until it leaves."""
        next_s = 0.0
        async for message in self._socket:
            try:
                if message.type is WSMsgType.PING:
                    await self._socket.pong(message.data)
                elif message.type is WSMsgType.TEXT:
                    await self._take(message.data)
                elif message.type is not WSMsgType.PONG:
                    raise ControlError("messages are text.")
            except ControlError as error:
                await self._send({"refused": str(error)})
            now_s = time.monotonic()
            next_s = max(next_s, now_s - BURST_S) + 1.0 / MAX_A_SECOND
            await asyncio.sleep(max(next_s - now_s, 0.0))  # others have their turn, and a flood waits in its sender

    async def _take(self, text: str) -> None:
        """Do what a message says; ControlError if it is none of those that `Session` names."""
        try:
            said = json.loads(text)
        except (ValueError, RecursionError):
            raise ControlError("a message is no JSON.") from None
        for name, value in mapping("a message", said).items():
            if name not in self._takers:
                raise ControlError(f"there is no message {shortened(name)}.")
            answer = self._takers[name](value)
            if name in ("turn", "nearer", "move"):
                self._page.pictures.schedule_render()
            if answer is not None:
                await self._send({name: answer})

    def _set(self, said: Any) -> None:
        self._page.set(said)
        self._shown["controls"] |= said

    async def _tell(self) -> None:
        """Send what has changed whenever something has, until cancelled."""
        while True:
            await self._page.is_changed.wait()
            self._page.is_changed.clear()
            shown = self._page.update() | {"controls": dict(self._page.controls)}
            changed = news(self._shown, shown) | {"controls": news(self._shown["controls"], shown["controls"])}
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
