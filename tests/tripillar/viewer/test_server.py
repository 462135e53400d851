"""Access to the page of `view --serve`: strangers can do nothing, browsers what the page shows.

The server runs in this process, on a real port, and is asked by real sockets.
"""

import asyncio
import json
import logging
import struct
import time

import aiohttp
import psutil
import pytest

from tests.tripillar.viewer.visitor import PATIENT_S, Visitor, frame, memory_mb, rest
from tripillar.viewer.page import server as server_module
from tripillar.viewer.page.page import BURST_S, MAX_A_SECOND
from tripillar.viewer.page.server import FILES, MAX_BROWSERS, MAX_BYTES, AddressError, Guard, Server, listening_on


@pytest.fixture(autouse=True)
def nothing_fails(caplog):
    yield
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR] == []


def on_page(*hosts, **bounds):
    """Make a test of a trial: a visitor of a running server whose bounds may be narrower."""

    def decorated(trial):
        async def tried(subject, host):
            server = Server(subject, host)
            try:
                await trial(Visitor(await server.start(listening_on(host, 0)), server))
            finally:
                await server.stop()

        def test(subject):
            with pytest.MonkeyPatch.context() as patch:
                for name, value in bounds.items():
                    patch.setattr(server_module, name, value)
                for host in hosts or ("127.0.0.1",):
                    asyncio.run(tried(subject, host))

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
    assert "script-src 'self';" in headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"  # the address holds the token
    for path in ("", *FILES):
        assert (await visitor.get(path, Cookie=visitor.cookie(visitor.token)))[0] == 200
    assert Guard("127.0.0.1").token != visitor.token


@on_page()
async def test_another_origin_or_host_is_refused_with_the_token_too(visitor):
    """A host is a name that its owner lets point here, so that the browser takes both for one site."""
    port, page = visitor.port, f"?token={visitor.token}"
    for origin, status in (
        (f"http://{visitor.netloc}", 101), ("http://evil.test", 403), ("null", 403), (None, 403),
        (f"http://evil.test:{port}", 403), (f"http://127.0.0.1:{port + 1}", 403), (f"http://localhost:{port}", 403),
        (f"http://127.0.0.1:{port}.evil.test", 403), (f"http://127.0.0.1:{port}/", 403),
    ):  # fmt: skip
        assert await visitor.asked_for_socket(Origin=origin) == status, origin
    assert (await visitor.get(page, Origin="http://evil.test"))[0] == 403
    for host in (
        "evil.test", f"evil.test:{port}", "127.0.0.1.evil.test", "127.0.0.2", "[::1]", "0.0.0.0", "2130706433", "",
        "127.0.0.1:evil", "127.0.0.1@evil.test", "[127.0.0.1", "127.0.0.1:80:80",
    ):  # fmt: skip
        assert await visitor.asked_for_socket(Host=host, Origin=f"http://{host}") == 403, host
        assert (await visitor.get(page, Host=host))[0] in (400, 403), host
    for host in (f"localhost:{port}", f"LOCALHOST:{port}", "localhost:9000", "127.0.0.1"):  # ssh -L
        assert await visitor.asked_for_socket(Host=host, Origin=f"http://{host}") == 101, host


@on_page("0.0.0.0", "::")
async def test_other_machines_come_by_the_address_that_they_ask_for(visitor):
    """All of 127.0.0.0/8 are addresses of this machine, as those of its network are."""
    for address, name, status in (
        ("127.0.0.2", "127.0.0.2", 200), ("127.0.0.2", "127.0.0.3", 403), ("127.0.0.2", "evil.test", 403),
        ("127.0.0.2", "0.0.0.0", 403), ("127.0.0.1", "127.0.0.1", 200),
    ):  # fmt: skip
        place = {"base": f"http://{address}:{visitor.port}/", "Host": f"{name}:{visitor.port}"}
        assert (await visitor.get(f"?token={visitor.token}", **place))[0] == status, name
        assert (await visitor.get("", **place))[0] == 403  # without the token


@pytest.mark.parametrize(
    ("host", "address", "is_ours"),
    [
        ("lab-pc.local:8080", "192.0.2.7", True), ("192.0.2.7:8080", "192.0.2.7", True),
        ("[2001:db8::1]:8080", "2001:db8:0:0::1", True), ("lab-pc", "192.0.2.7", False),
        ("localhost:8080", "192.0.2.7", False), ("192.0.2.8", "192.0.2.7", False),
        ("2001:db8::1", "192.0.2.7", False), ("", "192.0.2.7", False),
    ],
)  # fmt: skip
def test_a_name_that_the_user_gave_is_one_of_the_servers(host, address, is_ours):
    assert Guard("Lab-PC.local").is_ours(host, address) == is_ours


def test_a_port_that_is_taken_is_refused_in_a_line():
    with listening_on("127.0.0.1", 0) as taken, pytest.raises(AddressError, match=r"cannot listen on 127\.0\.0\.1"):
        listening_on("127.0.0.1", taken.getsockname()[1])
    with pytest.raises(AddressError, match="give another --host"):
        listening_on("192.0.2.1", 0)  # none of this machine's


@on_page()
async def test_only_the_pages_files_are_served_and_what_is_no_http_is_refused(visitor):
    async def status(request: str) -> int:
        reader, writer = await visitor.raw(f"{request} HTTP/1.1\r\nConnection: close\r\n\r\n")
        said = await rest(reader)
        writer.close()
        return int(said.split()[1])

    assert await status("GET /page.js") == 200
    for path in (
        "/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "//etc/passwd", "/server.py", "/page.js%00",
        "/page.js/../server.py", "/page.html", "/.", "/static/page.js", "http://evil.test/page.py",
    ):  # fmt: skip
        assert await status(f"GET {path}") in (400, 403, 404), path
    for method in ("POST", "DELETE", "TRACE", "CONNECT"):
        assert await status(f"{method} /page.js") in (400, 403, 404, 405), method
    assert await status("GET /socket") in (400, 403)  # no upgrade
    assert await status("GET /" + 100_000 * "a") in (400, 414)
    for words in (
        b"GET / HTTP/9.9", b"GET / HTTP/1.1\r\nHost: a\r\nHost: b", b"GET http://[ HTTP/1.1",
        b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\nContent-Length: 5", b"\x16\x03\x01\x02\x00\x01",
    ):  # fmt: skip
        reader, writer = await asyncio.open_connection("127.0.0.1", visitor.port)
        writer.write(words + b"\r\n\r\n")
        assert (await rest(reader)).split()[1] == b"400", words
        writer.close()


#: a value of each control that is out of bounds, of each kind that is not its own, and names that are no control
WRONG_VALUES = {
    "pad": [9999, -1, 0.5, "0", None, True, [0], {}, 10**400, float("nan")],
    "pressure": [-0.01, 5.01, float("nan"), float("inf"), "1", None, False, [1.0], 10**4000],
    "shear": [1.01], "angle": [361], "width": [0], "noise": [1.0], "rows": [[]], "__dict__": [1],
    "colour": ["unknown", "", None, 0, ["displacement"], "__class__"],
    "scale": [3, "1"], "dark": [1, "true", None], "cone": [2], "tab": ["other", 1],
    "source": ["sensor", None],  # there is no sensor
}  # fmt: skip
WRONG_MESSAGES = [
    "", "no JSON", "[]", '"set"', "{", '{"set": ' + "[" * 30_000, '{"set": ' + 900 * "[" + 900 * "]" + "}",
    *(json.dumps(message) for message in (
        {"file": "/etc/passwd"}, {"application.exit": []}, {"set": None}, {"set": [["pad", 1]]}, {"do": "exit"},
        {"do": ["reset"]}, {"turn": 1}, {"turn": [1, "2"]}, {"turn": [1e9, 0]}, {"nearer": 0},
        {"nearer": float("nan")}, {"move": [0, 6]}, {"size": [0, 100]}, {"size": [5000, 100]}, {"size": ["800", 600]},
        {"restore": {}}, {"restore": {"controls": {"pad": 9999}}},
        {"restore": {"controls": {}, "traction_mpa": [0.0] * 5}},
        {"restore": {"controls": {"pad": 2}, "traction_mpa": [0.0] * 6}},
    )),
]  # fmt: skip


@on_page()
async def test_what_no_control_can_say_is_refused_and_the_page_stays(visitor):
    values = [{"set": {name: value}} for name, wrong in WRONG_VALUES.items() for value in wrong]
    values.append({"set": {"pressure": 2.0, "pad": 9999}})  # one wrong: none is taken
    async with visitor.browser() as browser:
        before = dict(browser.controls)
        for message in (*map(json.dumps, values), *WRONG_MESSAGES):
            await browser.socket.send_str(message)
            assert await browser.heard("refused"), message[:80]
        await browser.socket.send_bytes(b"\x00" * 13)
        assert await browser.heard("refused") == "messages are text."
        await browser.change(set={"pressure": 1.0})
        assert browser.controls == before  # what the browser said itself is not told to it
        assert sorted(browser.shown["traction_mpa"]) == [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


@on_page()
async def test_each_browser_has_a_state_of_its_own_and_each_pad_its_load(visitor):
    async with visitor.browser() as one, visitor.browser() as other:
        await one.change(set={"source": "indenter", "colour": "vertical", "dark": True, "peak": 5.0})
        for said, told in (
            ({"pad": 0}, {}), ({"pressure": 2.0}, {}), ({"pad": 1}, {"pressure": 0.0}), ({"pressure": 3.0}, {}),
            ({"pad": 0}, {"pressure": 2.0}),
        ):  # fmt: skip
            assert (await other.change(set=said))["controls"] == told
        assert other.shown["traction_mpa"] == [0, 0, -2.0, 0, 0, -3.0]
        assert other.controls["colour"] == "displacement"
        assert (await other.change(do="reset"))["controls"]["pressure"] == 0.0
        assert not any(other.shown["traction_mpa"])
        await one.change(set={"at_x": 1.0})
        said = {"source": "indenter", "colour": "vertical", "dark": True, "peak": 5.0, "at_x": 1.0}
        kept = {"controls": one.controls | said, "traction_mpa": one.shown["traction_mpa"]}
    async with visitor.browser() as again:  # a browser that lost its connection goes on where it was
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
async def test_floods_are_refused_before_they_are_stored_or_wait_in_their_sender(visitor):
    """Claimed lengths; fragments without end, 20,000 values, as many pings: another browser is served meanwhile."""
    async with visitor.bystander() as other:
        for claimed in (MAX_BYTES + 1, 4 * 2**30, 2**64 - 1):  # it was 4 GB each
            reader, writer = await visitor.raw_socket()
            writer.write(frame(2, claimed, b""))
            assert struct.pack(">H", 1009) in (await rest(reader))[-200:], claimed  # message too big
            writer.close()
        reader, fragments = await visitor.raw_socket()
        fragments.write(frame(1, 1000, b"x" * 1000, fin=False))
        for _ in range(1000):
            fragments.write(frame(0, 1000, b"x" * 1000, fin=False))
        await rest(reader)
        _, values = await visitor.raw_socket()
        said = b'{"set":{"pressure":%d}}'
        for number in range(20_000):
            values.write(frame(1, len(said) - 1, said % (number % 5)))
        _, pings = await visitor.raw_socket()
        for _ in range(20_000):
            pings.write(frame(9, 100, 100 * b"p"))
        waited_s = []
        for number in range(10):
            start = time.perf_counter()
            await other.change(set={"pressure": 0.5 + 0.1 * number})
            waited_s.append(time.perf_counter() - start)
        assert sorted(waited_s)[5] < 1.0
        for writer in (fragments, values, pings):
            writer.transport.abort()
            writer.close()


@on_page()
async def test_messages_are_read_at_the_rate_of_a_screen(visitor):
    async with visitor.browser() as browser:
        start, count = time.perf_counter(), int(1.5 * MAX_A_SECOND)
        for _ in range(count):
            await browser.say(set={"pad": 9999})
        for _ in range(count):
            await browser.heard("refused")
        assert time.perf_counter() - start > 1.5 - BURST_S - 0.1


@on_page()
async def test_who_reads_nothing_keeps_nobody_waiting(visitor):
    """Another browser is served meanwhile, and the server stops soon."""
    _, writer = await visitor.raw_socket()
    writer.transport.pause_reading()
    async with visitor.bystander():
        for number in range(30):
            said = json.dumps({"set": {"pressure": 0.05 * number}, "turn": [5, 0], "size": [1000, 1000]}).encode()
            writer.write(frame(1, len(said), said))
            await asyncio.sleep(0.02)
    start = time.perf_counter()
    await visitor.stop()
    writer.close()
    assert time.perf_counter() - start < 5.0


@on_page(MAX_CONNECTIONS=8, PATIENCE_S=1.0)
async def test_connections_that_ask_nothing_end_and_hold_no_place(visitor):
    async with visitor.bystander():  # a browser that is silent as long stays
        silent = [await asyncio.open_connection("127.0.0.1", visitor.port) for _ in range(30)]  # more than places
        assert (await visitor.get(f"?token={visitor.token}"))[0] == 200
        slow = await visitor.raw("GET / HTTP/1.1\r\n")

        async def dripping() -> None:
            while not slow[1].is_closing():
                slow[1].write(b"X-Word: 1\r\n")
                await asyncio.sleep(0.1)

        drips = asyncio.create_task(dripping())
        for reader, _ in [*silent, slow]:
            await rest(reader)
        drips.cancel()
        for _, writer in [*silent, slow]:
            writer.close()


@on_page()
async def test_browsers_that_leave_give_everything_back(visitor):
    for number in range(6):
        if number == 2:
            before = memory_mb(), psutil.Process().num_fds()
        async with visitor.browser() as browser:
            await browser.say(size=[800, 600], turn=[1, 0])
            await browser.heard("picture")
    async with asyncio.timeout(PATIENT_S):
        while psutil.Process().num_fds() > before[1] + 3:
            await asyncio.sleep(0.1)
    assert memory_mb() - before[0] < 50  # 4 scenes that stayed took 80
