"""The page that `tripillar view --save x.html` writes: PyVista's viewer in a frame of our own, for any screen."""

import re
from html import escape
from pathlib import Path

from fem.pictures.colours import Bar
from fem.pictures.deformation import DeformedPicture

STYLE = Path(__file__).with_name("saved.css").read_text(encoding="utf-8")  #: of a page
#: pictures one below the other where the window is higher than wide
STACKED = """
const many = matchMedia('(max-aspect-ratio: 1)');
function stack() {
  const all = window.global.renderWindow?.getRenderers() ?? [];
  const renderers = all.filter(one => one.getActors().length);
  const n = renderers.length;
  if (n < +getComputedStyle(document.querySelector('main')).getPropertyValue('--n')) return setTimeout(stack, 50);
  renderers.forEach((one, k) => one.setViewport(
    ...(many.matches ? [0, 1 - (k + 1) / n, 1, 1 - k / n] : [k / n, 0, (k + 1) / n, 1])));
  window.global.renderWindow.render();
}
many.addEventListener('change', stack);
stack();
"""
#: what browsers are told of a page: nothing comes from anywhere but the file itself
NOTHING_FROM_OUTSIDE = (
    "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:\">"
)


def own_page(page: str, picture: DeformedPicture) -> str:
    """The viewer's page with our title, names and colour bars; it loads nothing, its icons included."""
    head = f"<title>TriPillar: {escape(', '.join(picture.names))}</title>{NOTHING_FROM_OUTSIDE}<style>{STYLE}</style>"
    page = re.sub("<title>.*?</title>", lambda _: head, page, count=1)
    page = re.sub(r"https://[^`\"']*/favicon-[^`\"']*", "data:,", page)
    start, end, rest = page.rpartition("</body>")
    return start + _stage(picture) + end + rest


def _stage(picture: DeformedPicture) -> str:
    """The place of the viewer, which empties what it fills, with names above its pictures, and colour bars, as HTML."""
    names = "".join(f"<span>{escape(name)}</span>" for name in picture.names)
    bars = "".join(_bar(bar) for bar in picture.bars)
    return (
        f'<main style="--n: {len(picture.names)}; --aspect: {picture.aspect:.3f}"><div class="stage">'
        f'<div class="frame"><div class="content"></div><div class="names">{names}</div></div></div>'
        f'<div class="legend">{bars}<div>{picture.note}<br><span class="dim">drag to turn, scroll or pinch to zoom'
        f"</span></div></div></main><script>{STACKED}</script>"
    )


def _bar(bar: Bar) -> str:
    """A colour bar as HTML."""
    labels = "".join(
        f'<span style="left:{100 * (value - bar.low) / (bar.high - bar.low):.2f}%">{words}</span>'
        for value, words in bar.labels.items()
    )
    gradient = ", ".join(bar.colours[::6] + bar.colours[-1:])
    return (
        f'<div class="bar">{bar.title}<div style="background:linear-gradient(to right, {gradient})"></div>'
        f'<div class="labels">{labels}</div></div>'
    )
