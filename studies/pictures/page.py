"""The page of `tripillar view --serve` in headless Chromium, for benchmarks and for the picture in the docs.

`python -m studies draw-page docs/page.png` draws that picture.
"""

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

from common.errors import DesignError
from studies.charts import save_small

CHROMIUM = Path("/usr/bin/chromium")  #: Debian's
PATIENCE_MS = 60_000
SETTLED_MS = 2500  #: without news: the fine picture has come


@contextmanager
def page_in_chromium(*options: str, size: tuple[int, int] = (1280, 800)) -> Iterator[Any]:
    """Serve a page by `tripillar view --serve` with these options, and look at it; playwright's page.

    Needs playwright and Debian's Chromium.
    """
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "tripillar", "view", "--serve", "--http-port", "0", "--json", "-q", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8") as server, sync_playwright() as playwright:
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


def draw(out: Path) -> None:
    """Draw the page under a round indenter that drags."""
    with page_in_chromium(size=(1280, 800)) as page:
        page.click("#by-indenter")
        page.click("#pad-14")
        for slider, steps in {"peak": 20, "drag": 40, "drag_angle": 6}.items():
            page.focus(f"#{slider} input")
            for _ in range(steps):
                page.keyboard.press("ArrowRight")
        page.mouse.click(640, 760)  # takes the focus off the slider
        said = None
        while (now := page.inner_text("#times")) != said:
            said = now
            page.wait_for_timeout(SETTLED_MS)
        with Image.open(io.BytesIO(page.screenshot())) as screen:
            save_small(screen, out)
