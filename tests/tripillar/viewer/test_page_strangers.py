"""The page of `view --serve` in a real browser: beside another site, and after a lost connection."""

import asyncio
import os
from contextlib import asynccontextmanager

import pytest
from aiohttp import web

from tests.tripillar.viewer.test_server import Visitor
from tripillar.viewer.page.server import Server

CHROMIUM = "/usr/bin/chromium"
PATIENT_MS = 30_000
#: of another site: whatever a page can make a browser ask; each answer that it gets is a name in the list
ATTACK = """async target => {
  const got = [];
  const within = (promise, name) => Promise.race([promise, new Promise(done => setTimeout(done, 5000))]).then(
    yes => yes && got.push(name), () => {});
  const socket = new WebSocket(target.replace("http", "ws") + "socket");
  await within(new Promise(done => {
    socket.onopen = () => { socket.send('{"set": {"pressure": 5}}'); done(true); };
    socket.onerror = () => done(false);
  }), "socket");
  for (const mode of ["cors", "no-cors"]) for (const method of ["GET", "POST"])
    await within(fetch(target + "page.js", { mode, method, credentials: "include" }).then(answer => answer.ok),
      `${method} ${mode}`);
  for (const [tag, name] of [["script", "src"], ["link", "href"], ["img", "src"]]) {
    const element = document.createElement(tag);
    Object.assign(element, { [name]: target + "page.js", rel: "stylesheet" });
    await within(new Promise(done => {
      element.onload = () => done(true);
      element.onerror = () => done(false);
      document.head.append(element);
    }), tag);
  }
  const frame = document.body.appendChild(document.createElement("iframe"));
  frame.src = target;
  await new Promise(done => setTimeout(done, 500));
  try { if (frame.contentDocument?.querySelector("#pads")) got.push("frame"); } catch {}
  return got;
}"""

#: as one would try who got words of his own into the page
INJECTED = """() => {
  const script = document.createElement("script");
  script.textContent = "window.got = 1";
  document.body.append(script);
}"""


@asynccontextmanager
async def looking(subject):
    """A server, its visitor, and a browser with its page open; evil.test is this machine to the browser."""
    if not os.path.exists(CHROMIUM):
        pytest.skip(f"no {CHROMIUM}: install Debian's chromium")
    api = pytest.importorskip("playwright.async_api")
    server = Server(subject, "127.0.0.1")
    url = await server.start("127.0.0.1", 0)
    try:
        async with api.async_playwright() as playwright:
            flags = ["--no-sandbox", "--host-resolver-rules=MAP evil.test 127.0.0.1"]
            browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
            context = await browser.new_context()
            context.set_default_timeout(PATIENT_MS)
            yield Visitor(url), url, context
            await browser.close()
    finally:
        await server.stop()


async def is_shown(page, selector, text):
    """Wait until an element says something; by asking from outside, for the page's policy forbids evaluated words."""
    async with asyncio.timeout(PATIENT_MS / 1e3):
        while (await page.inner_text(selector)).strip() != text:
            await asyncio.sleep(0.05)


async def other_site(site):
    await site.setup()
    listening = web.TCPSite(site, "127.0.0.1", 0)
    await listening.start()
    return site.addresses[0][1]


def test_another_site_in_the_same_browser_gets_nothing(subject):
    async def blank(request):
        return web.Response(text="<!doctype html><title>evil</title><body>", content_type="text/html")

    async def trial():
        async with looking(subject) as (visitor, url, context):
            page = await context.new_page()
            said = []
            page.on("console", lambda message: said.append(message.text))
            await page.goto(url)
            await page.wait_for_selector("#pads button")
            await is_shown(page, "#strain b", "0.0 %")
            assert page.url == visitor.base  # without the token
            assert await page.evaluate("document.cookie") == ""  # HttpOnly
            await page.reload()  # the cookie is enough
            await page.wait_for_selector("#pads button")
            assert said == []
            await page.evaluate(INJECTED)
            assert await page.evaluate("window.got") is None
            assert "Content Security Policy" in said[0]

            app = web.Application()
            app.router.add_get("/", blank)
            site = web.AppRunner(app)
            port = await other_site(site)
            for name in ("evil.test", "127.0.0.1"):  # to cookies another port is the same site
                stranger = await context.new_page()
                await stranger.goto(f"http://{name}:{port}/")
                assert await stranger.evaluate(ATTACK, visitor.base) == []
                await stranger.close()
            rebound = await context.new_page()  # a name of its own for the server's address: its origin is the page's
            for path in ("", f"?token={visitor.token}"):
                answer = await rebound.goto(f"http://evil.test:{visitor.port}/{path}")
                assert answer.status == 403
            assert await rebound.evaluate(ATTACK, f"http://evil.test:{visitor.port}/") == []
            assert await rebound.evaluate("() => fetch('page.js').then(answer => answer.status)") == 403
            await site.cleanup()
            assert await page.inner_text("#strain b") == "0.0 %"

    asyncio.run(trial())


def test_a_lost_connection_goes_on_where_it_was(subject):
    async def trial():
        async with looking(subject) as (_, url, context):
            page = await context.new_page()
            sockets = []

            def through(socket):
                socket.connect_to_server()
                sockets.append(socket)

            await page.route_web_socket("**/socket", through)
            await page.goto(url)
            await page.click("#pad-0")
            await page.fill("#pressure input", "2")
            await is_shown(page, "#pad-0", "2.0")
            await sockets[0].close()
            await is_shown(page, "#trouble", "no connection: has tripillar ended?")
            await is_shown(page, "#trouble", "")
            await is_shown(page, "#pad-0", "2.0")
            assert len(sockets) == 2
            await page.click("#reset")
            await is_shown(page, "#strain b", "0.0 %")

    asyncio.run(trial())
