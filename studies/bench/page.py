"""Response times of the page: `python -m studies.bench.page`, in headless Chromium on this machine.

The pressure slider moves by one step; measured are the times until the browser shows the new numbers and
until it shows a new picture, and what the server says that it took to compute and to draw.
"""

import json
import os
import re
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from common.storage.files import write_text
from studies.pictures.page import page_in_chromium
from studies.program import run_alone

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


def measure(
    out: Annotated[Path | None, Parameter(help="JSON file to write.")] = None,
    width: Annotated[int, Parameter(help="Size of the browser's window [px].")] = 1280,
    height: Annotated[int, Parameter(help="Size of the browser's window [px].")] = 800,
) -> None:
    """Measure and print one JSON object."""
    load = os.getloadavg()[0]
    with page_in_chromium(size=(width, height)) as page:
        page.wait_for_timeout(2000)
        steps = [page.evaluate(STEP) for _ in range(WARM_UP + STEPS)][WARM_UP:]
    server = np.array([[float(number) for number in re.findall(r"(\d+) ms", said)] for *_, said in steps])
    names = ("to_numbers_ms", "to_picture_ms", "server_computes_ms", "server_draws_ms")
    columns = [*np.array([step[:2] for step in steps], dtype=float).T, *server.T]
    found: dict[str, Any] = {"window_px": [width, height], "steps": STEPS, "load_before": load}
    for name, values in zip(names, columns, strict=True):
        found[name] = {"median": float(np.median(values)), "p90": float(np.percentile(values, 90))}
    print(json.dumps(found, indent=2))
    if out is not None:
        write_text(json.dumps(found, indent=2) + "\n", out)


if __name__ == "__main__":
    run_alone(measure)
