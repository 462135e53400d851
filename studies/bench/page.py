"""``python -m studies page``: response times of the page, in headless Chromium on this machine.

The pressure slider moves by one step; measured are the times until the browser shows the new numbers and
until it shows a new picture, and what the server says that it took to compute and to draw.
"""

import os
import re
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from studies.pictures.page import page_in_chromium
from studies.tables import OUT, Folder, report

WARM_UP, STEPS = 4, 30
#: moves the slider once; gives the times [ms] until numbers and picture are new, and what the server says
STEP = """async () => {
  const thumb = document.querySelector('#peak input'), numbers = document.querySelector('#strain');
  const pictures = () => [...document.querySelectorAll('.middle img')];
  const shown = () => pictures().map(picture => picture.src).join();
  const oldNumbers = numbers.textContent, oldPictures = shown(), start = performance.now();
  thumb.stepUp();
  thumb.dispatchEvent(new Event('input', {bubbles: true}));
  let toNumbers = 0, toPicture = 0;
  while (!(toNumbers && toPicture) && performance.now() - start < 5000) {
    await new Promise(resolve => requestAnimationFrame(resolve));
    const now = performance.now() - start;
    if (!toNumbers && numbers.textContent != oldNumbers) toNumbers = now;
    if (!toPicture && shown() != oldPictures && pictures().every(picture => picture.complete)) toPicture = now;
  }
  await new Promise(resolve => setTimeout(resolve, 1000));  // until all is still
  return [toNumbers, toPicture, document.querySelector('#times').textContent];
}"""


def page(
    out: Folder = OUT,
    width: Annotated[int, Parameter(help="Width of the browser's window [px].")] = 1280,
    height: Annotated[int, Parameter(help="Height of the browser's window [px].")] = 800,
) -> None:
    """Measure times from a step of the slider [ms]."""
    load = os.getloadavg()[0]
    with page_in_chromium(size=(width, height)) as shown:
        shown.wait_for_timeout(2000)
        steps = [shown.evaluate(STEP) for _ in range(WARM_UP + STEPS)][WARM_UP:]
    server = np.array([[float(number) for number in re.findall(r"(\d+) ms", said)] for *_, said in steps])
    columns = zip(
        ("until new numbers", "until a new picture", "the server computes", "the server draws"),
        [*np.array([step[:2] for step in steps], dtype=float).T, *server.T],
        strict=True,
    )
    rows = [
        {"time [ms]": name, "median": float(np.median(values)), "90 %": float(np.percentile(values, 90))}
        for name, values in columns
    ]
    report({f"{STEPS} steps of the slider, {width} × {height} px": rows}, out / "page.json", {"load before": load})
