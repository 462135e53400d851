"""The page of `tripillar view --serve`, as a picture for the docs: `python -m studies.pictures.page docs/page.png`."""

import io
from pathlib import Path

import numpy as np
from PIL import Image

from studies.charts import save_small
from studies.pictures.browser import page_in_chromium
from tripillar.terminal.entry import run_alone

SETTLED_MS = 2500  #: without news: the fine picture has come


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
            save_small(np.asarray(screen.convert("RGB")), out)


if __name__ == "__main__":
    run_alone(draw)
