"""Access to the page of `view --serve`: strangers can do nothing, browsers what the page shows.

The server runs in this process, on a real port, and is asked by real sockets.
"""

import asyncio
import json
import logging
import struct

import aiohttp
import numpy as np
import psutil
import pytest

from hardware.streams.stream import listening_on
from tests.house import PATIENT_S
from tests.tripillar.viewer.visitor import Visitor, frame, memory_mb, rest
from tripillar.viewer.page import server as server_module
from tripillar.viewer.page.server import FILES, MAX_BROWSERS, MAX_BYTES, Guard, Server


def on_page(**bounds):
    """Make a test of a trial: a visitor of a running server whose bounds may be narrower, and which stops soon."""

    def decorated(trial):
        async def tried(subject):
            server = Server(subject, "127.0.0.1")
            try:
                left = await trial(Visitor(await server.start(listening_on("127.0.0.1", 0))))
            finally:
                async with asyncio.timeout(PATIENT_S):  # whoever is there
                    await server.stop()
            for _, writer in left or ():
                writer.close()

        def test(subject, caplog):
            with pytest.MonkeyPatch.context() as patch:
                for name, value in bounds.items():
                    patch.setattr(server_module, name, value)
                asyncio.run(tried(subject))
            assert [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR] == []

        test.__doc__ = trial.__doc__
        return test

    return decorated


@on_page()
async def test_the_token_is_asked_for_and_kept_in_a_strict_cookie(visitor):
    for path in ("", *FILES, "socket", "?token=", "?token=wrong", "nothing", f"page.js?token={visitor.token}"):
        assert (await visitor.get(path))[0] == 403, path  # the token opens the page alone
    for token in ("wrong", "\xff"):
        assert (await visitor.get("page.js", Cookie=visitor.cookie(token)))[0] == 403
    status, headers, text = await visitor.get(f"?token={visitor.token}")
    assert (status, visitor.token in text, len(visitor.token) >= 43) == (200, False, True)  # 256 bits
    said = headers["Set-Cookie"]
    assert said.startswith(visitor.cookie(visitor.token))
    assert {"HttpOnly", "SameSite=Strict"} <= {word.strip() for word in said.split(";")}
    for rule in ("script-src 'self';", "frame-ancestors 'none'"):
        assert rule in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"  # the address holds the token
    assert all([(await visitor.get(path, Cookie=said.split(";")[0]))[0] == 200 for path in ("", *FILES)])


@on_page()
async def test_another_origin_or_host_is_refused_with_the_token_too(visitor):
    """A host is a name that its owner lets point here, so that the browser takes both for one site."""
    port, page = visitor.port, f"?token={visitor.token}"
    for origin, status in (
        (f"http://{visitor.netloc}", 101), ("http://evil.test", 403), ("null", 403), (None, 403),
        (f"http://evil.test:{port}", 403), (f"http://127.0.0.1:{port + 1}", 403), (f"http://localhost:{port}", 403),
        (f"http://127.0.0.1:{port}.evil.test", 403),
    ):  # fmt: skip
        assert await visitor.asked_for_socket(Origin=origin) == status, origin
    assert (await visitor.get(page, Origin="http://evil.test"))[0] == 403
    for host in (
        "evil.test", f"evil.test:{port}", "127.0.0.1.evil.test", "127.0.0.2", "[::1]", "0.0.0.0", "2130706433", "",
        "127.0.0.1:evil", "127.0.0.1@evil.test", "[127.0.0.1", "127.0.0.1:80:80",
    ):  # fmt: skip
        assert await visitor.asked_for_socket(Host=host, Origin=f"http://{host}") == 403, host
        assert (await visitor.get(page, Host=host))[0] in (400, 403), host
    for host in (f"LOCALHOST:{port}", "localhost:9000", "127.0.0.1"):  # ssh -L
        assert await visitor.asked_for_socket(Host=host, Origin=f"http://{host}") == 101, host


def test_other_machines_come_by_the_address_that_they_ask_for_or_the_name_that_the_user_gave():
    for host, address, is_ours in (
        ("127.0.0.2:80", "::ffff:127.0.0.2", True), ("127.0.0.3:80", "127.0.0.2", False), ("lab", "192.0.2.7", False),
        ("0.0.0.0", "127.0.0.2", False), ("lab-pc.local:8080", "192.0.2.7", True), ("2001:db8::1", "192.0.2.7", False),
        ("[2001:db8::1]:8080", "2001:db8:0:0::1", True), ("localhost:8080", "192.0.2.7", False),
    ):  # fmt: skip
        assert Guard("Lab-PC.local").is_ours(host, address) == is_ours, host


@on_page()
async def test_only_the_pages_files_are_served_and_what_is_no_http_is_refused(visitor):
    for request, allowed in (
        ("GET /page.js", [200]), ("GET /socket", [400, 403]), ("GET /" + 100_000 * "a", [400, 414]),
        *((f"{method} /page.js", [400, 403, 404, 405]) for method in ("POST", "DELETE", "TRACE", "CONNECT")),
        *((f"GET {path}", [400, 403, 404]) for path in (
            "/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "//etc/passwd", "/server.py", "/page.js%00",
            "/page.js/../server.py", "/page.html", "/.", "http://evil.test/page.py",
        )),
    ):  # fmt: skip
        reader, writer = await visitor.raw(f"{request} HTTP/1.1\r\nConnection: close\r\n\r\n")
        assert int((await rest(reader)).split()[1]) in allowed, request[:80]
        writer.close()
    for words in (
        b"GET / HTTP/9.9", b"GET / HTTP/1.1\r\nHost: a\r\nHost: b", b"GET http://[ HTTP/1.1",
        b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\nContent-Length: 5", b"\x16\x03\x01\x02\x00\x01",
    ):  # fmt: skip
        reader, writer = await asyncio.open_connection("127.0.0.1", visitor.port)
        writer.write(words + b"\r\n\r\n")
        assert (await rest(reader)).split()[1] == b"400", words
        writer.close()


#: values of controls that are out of bounds or of another kind, and names that are no control
WRONG_VALUES = {
    "pad": [9999, -1, 0.5, "0", None, True, [0], {}, 10**400, float("nan")],
    "pressure": [-0.01, 5.01, float("nan"), float("inf"), "1", None, False, [1.0], 10**4000],
    "rows": [[]], "__dict__": [1], "colour": ["unknown", None, ["displacement"], "__class__"], "cone": [2],
    "source": ["sensor"],  # there is no sensor
}  # fmt: skip
WRONG_MESSAGES = [
    "", "no JSON", "[]", '{"set": ' + "[" * 30_000, '{"set": ' + 900 * "[" + 900 * "]" + "}",
    *(json.dumps(message) for message in (
        *({"set": {name: value}} for name, wrong in WRONG_VALUES.items() for value in wrong),
        {"set": {"pressure": 2.0, "pad": 9999}},  # one wrong: none is taken
        {"file": "/etc/passwd"}, {"set": None}, {"set": [["pad", 1]]}, {"do": "exit"}, {"do": ["reset"]},
        {"turn": 1}, {"turn": [1, "2"]}, {"turn": [1e9, 0]}, {"nearer": float("nan")}, {"move": [0, 6]},
        {"size": [0, 100]}, {"size": [5000, 100]}, {"restore": {}}, {"restore": {"controls": {"pad": 9999}}},
        {"restore": {"controls": {}, "traction_mpa": [0.0] * 5}},
    )),
]  # fmt: skip


@on_page()
async def test_what_no_control_can_say_is_refused_and_the_page_stays(visitor):
    async with visitor.browser() as browser:
        await browser.load_by_pads()
        before = dict(browser.controls)
        for message in WRONG_MESSAGES:
            await browser.socket.send_str(message)
            assert await browser.heard("refused"), message[:80]
        await browser.socket.send_bytes(b"\x00" * 13)
        assert await browser.heard("refused") == "messages are text."
        await browser.change(set={"pressure": 1.0})
        assert browser.controls == before  # what the browser said itself is not told to it
        assert sorted(browser.shown["traction_mpa"]) == [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


@on_page()
async def test_each_browser_has_a_state_of_its_own_and_each_pad_its_load(visitor):
    """Shear is held by friction; a browser that lost its connection goes on where it was."""
    async with visitor.browser() as one, visitor.browser() as other:
        pressed = one.shown["traction_mpa"]
        assert pressed == pytest.approx([0, 0, -np.exp(-1 / 8) * 3.0] * 2, abs=1e-3)  # by the indenter at first
        await other.load_by_pads()
        for said, told in (
            ({"pad": 0}, {}), ({"pressure": 2.0}, {}), ({"pad": 1}, {"pressure": 0.0}),
            ({"pressure": 1.0, "shear": 1.0, "angle": 90}, {}),
            ({"pad": 0}, {"pressure": 2.0, "shear": 0.0, "angle": 0.0}),
            ({"pad": 1}, {"pressure": 1.0, "shear": 0.2, "angle": 90.0}),
        ):  # fmt: skip
            assert (await other.change(set=said))["controls"] == told
        assert other.shown["traction_mpa"] == [0, 0, -2.0, 0, 0.2, -1.0]
        assert one.shown["traction_mpa"] == pressed
        kept = {"controls": other.controls | {"pad": 1}, "traction_mpa": other.shown["traction_mpa"]}
        await other.change(do="reset")
        assert not any(other.shown["traction_mpa"])
    async with visitor.browser() as again:
        await again.change(restore=kept)
        assert {"controls": again.controls, "traction_mpa": again.shown["traction_mpa"]} == kept


@on_page(HEARTBEAT_S=1.0, MAX_BROWSERS=1)
async def test_one_browser_too_many_is_told_so_and_a_silent_one_leaves_its_place(visitor):
    assert MAX_BROWSERS == 8
    async with visitor.browser(), visitor.browser(is_served=False) as refused:
        with pytest.raises(ConnectionResetError, match=str(aiohttp.WSCloseCode.TRY_AGAIN_LATER.value)):
            await refused.heard("show")
    await visitor.wait_for_a_place()
    reader, writer = await visitor.raw_socket()  # answers no ping
    await rest(reader)
    writer.close()
    await visitor.wait_for_a_place()


@on_page()
async def test_who_floods_or_reads_nothing_takes_neither_memory_nor_time_of_others(visitor):
    """Claimed lengths; fragments without end; 3000 values, as many pings; pictures that nobody takes."""
    async with visitor.browser() as other:
        before_mb = memory_mb()
        endless = frame(1, 1000, 1000 * b"x", fin=False) + 1000 * frame(0, 1000, 1000 * b"x", fin=False)
        for too_much in (frame(2, MAX_BYTES + 1, b""), frame(2, 2**64 - 1, b""), endless):
            reader, writer = await visitor.raw_socket()
            writer.write(too_much)
            assert struct.pack(">H", 1009) in (await rest(reader))[-200:] or too_much is endless  # message too big
            writer.close()
        senders = [await visitor.raw_socket() for _ in range(3)]
        values, pings, deaf = (writer for _, writer in senders)
        said = b'{"set":{"pressure":%d}}'
        values.write(b"".join(frame(1, len(said) - 1, said % (number % 5)) for number in range(3000)))
        pings.write(3000 * frame(9, 100, 100 * b"p"))
        deaf.transport.pause_reading()
        for number in range(10):
            said = json.dumps({"set": {"pressure": 0.05 * number}, "turn": [5, 0], "size": [1000, 1000]}).encode()
            deaf.write(frame(1, len(said), said))
            await other.change(set={"pressure": 0.5 + 0.1 * number})
        assert memory_mb() - before_mb < 250  # scenes of five browsers
    return senders  # the server ends though they are there


@on_page(MAX_CONNECTIONS=8, PATIENCE_S=1.0)
async def test_connections_that_ask_nothing_end_and_hold_no_place(visitor):
    async with visitor.browser() as browser:  # silent as long, it stays
        silent = [await asyncio.open_connection("127.0.0.1", visitor.port) for _ in range(30)]  # more than places
        assert (await visitor.get(f"?token={visitor.token}"))[0] == 200
        slow = await visitor.raw("GET / HTTP/1.1\r\n")

        while not slow[1].is_closing():
            slow[1].write(b"X-Word: 1\r\n")
            await asyncio.sleep(0.1)
        for reader, writer in silent:
            await rest(reader)
            writer.close()
        await browser.change(set={"pressure": 1.0})


@on_page()
async def test_browsers_that_leave_give_everything_back(visitor):
    for number in range(5):
        if number == 1:
            before = memory_mb(), psutil.Process().num_fds()
        async with visitor.browser() as browser:
            await browser.say(size=[800, 600], turn=[1, 0])
            await browser.heard("picture")
    async with asyncio.timeout(PATIENT_S):
        while psutil.Process().num_fds() > before[1] + 3:
            await asyncio.sleep(0.1)
    assert memory_mb() - before[0] < 50  # 4 scenes that stayed took 80
