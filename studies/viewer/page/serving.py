"""The page's server: from a free port to Ctrl-C."""

import asyncio
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from trame.app import get_server

from fem.array_field import ArrayField
from studies.viewer.page.address import page_url
from studies.viewer.page.feed import SensorFeed
from studies.viewer.page.layout import lay_out
from studies.viewer.page.page import Page
from studies.viewer.page.sensing import ForceSource, SensorModel


def serve(
    field: ArrayField,
    sensor: SensorModel,
    source: ForceSource,
    feed: SensorFeed | None,
    host: str,
    port: int,
    on_ready: Callable[[str], None],
) -> None:
    """Serve the page until Ctrl-C or a termination.

    Parameters
    ----------
    field, sensor, source, feed
        As `Page` takes them.
    host, port : str, int
        Where to listen; port 0 is any free one.
    on_ready : callable
        Told the page's address once browsers can come.

    Raises
    ------
    OSError
        If that port cannot be listened on; `require_free` says so earlier.
    """
    asyncio.run(_serve(field, sensor, source, feed, host, port, on_ready))


async def _serve(
    field: ArrayField,
    sensor: SensorModel,
    source: ForceSource,
    feed: SensorFeed | None,
    host: str,
    port: int,
    on_ready: Callable[[str], None],
) -> None:
    server = get_server("tripillar", client_type="vue3")
    page = Page(server.state, field, sensor, source, feed)
    lay_out(server, page, field.design, source.name)
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(_unless_browser_left)
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    server.controller.on_server_ready.add(lambda **_: on_ready(page_url(host, server.port)))
    with _own_command_line():
        listening = server.start(
            port=port, host=host, timeout=0, open_browser=False, show_connection_info=False, exec_mode="task"
        )
    working, ending = asyncio.create_task(page.run()), asyncio.create_task(ended.wait())
    await asyncio.wait([listening, working, ending], return_when=asyncio.FIRST_COMPLETED)
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.remove_signal_handler(number)  # a second Ctrl-C interrupts
    for task in (working, ending):
        task.cancel()
    if not listening.done():
        await server.stop()
    await listening
    with suppress(asyncio.CancelledError):
        await working


def _unless_browser_left(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Tell of what fails in the background, but not of what was on its way to a browser that has gone."""
    if not isinstance(context.get("exception"), ConnectionResetError):
        loop.default_exception_handler(context)


@contextmanager
def _own_command_line() -> Iterator[None]:
    """Hide our options from trame, which reads the command line by itself and would take --port for its own.

    Its own option for us: pictures are compressed already.
    """
    given = sys.argv
    sys.argv = [*given[:1], "--no-ws-compress", "--nosignalhandlers"]
    try:
        yield
    finally:
        sys.argv = given
