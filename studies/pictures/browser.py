"""The page in headless Chromium, driven from here: for its picture in the docs and to measure how quick it is."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from geometry.errors import DesignError

CHROMIUM = Path("/usr/bin/chromium")  #: Debian's
PATIENCE_MS = 60_000


@contextmanager
def page_in_chromium(*options: str, size: tuple[int, int] = (1280, 800)) -> Iterator[Any]:
    """Serve a page by `tripillar view --serve` with these options, and look at it; playwright's page.

    Needs playwright and Debian's Chromium.
    """
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "tripillar", "view", "--serve", "--http-port", "0", "--json", "-q", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as playwright:
        try:
            assert server.stdout is not None
            line = server.stdout.readline()
            if not line:
                raise DesignError("the page did not start: its own message is above.")
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            page.goto(json.loads(line)["url"])
            page.wait_for_selector("#pads button", timeout=PATIENCE_MS)
            page.wait_for_selector(".middle img[src]", state="attached", timeout=PATIENCE_MS)
            yield page
            browser.close()
        finally:
            server.terminate()
