"""Files of a picture: PNG, a page for any browser, a film, or parts with their fields for ParaView."""

import itertools
import os
import re
import shutil
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyvista as pv

from common.errors import NotWrittenError
from common.storage.files import replacing, scratch, vtk_content, write_bytes, write_text
from fem.kernel.field import pressure, von_mises
from fem.pictures.deformation import Bar, DeformedPicture, Medium
from fem.pictures.parts import Part, Parts

FRAMES, HELD, RATE = 78, 18, 24  #: of a film: all, those at its end under the whole load, and frames a second
#: of the saved page; the script places pictures one below the other where the window is higher than wide
STYLE, SCRIPT = (Path(__file__).with_name(f"saved.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
#: the policy of the saved page: nothing is loaded from anywhere but the file itself
NOTHING_FROM_OUTSIDE = (
    "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:\">"
)


def save_png(picture: DeformedPicture, path: Path, done: Callable[[], None]) -> None:
    """Write a PNG."""
    with replacing(path) as temporary:
        picture.plotter.screenshot(temporary)
    done()


def save_html(picture: DeformedPicture, path: Path, done: Callable[[], None]) -> None:
    """Write a page in which the picture can be turned; it opens without a network."""
    import asyncio

    from trame_pyvista.jupyter import launch_server

    async def exported() -> str:
        """The page of PyVista's own exporter, which needs a server on loopback."""
        server = launch_server(host="127.0.0.1", port=0)
        await server.ready
        try:
            return picture.plotter.trame.export_html(None).getvalue()
        finally:
            await server.stop()

    page = asyncio.run(exported())
    write_text(own_page(page, picture), path)
    done()


def own_page(page: str, picture: DeformedPicture) -> str:
    """The viewer's page with our title, names and colour bars; it loads nothing, its icons included."""
    head = f"<title>TriPillar: {escape(', '.join(picture.names))}</title>{NOTHING_FROM_OUTSIDE}<style>{STYLE}</style>"
    page = re.sub("<title>.*?</title>", lambda _: head, page, count=1)
    page = re.sub(r"https://[^`\"']*/favicon-[^`\"']*", "data:,", page)
    start, end, rest = page.rpartition("</body>")
    return start + _stage(picture) + end + rest


def _stage(picture: DeformedPicture) -> str:
    """HTML of the place that the viewer fills, with names above its pictures and colour bars below."""
    names = "".join(f"<span>{escape(name)}</span>" for name in picture.names)
    bars = "".join(_bar(bar) for bar in picture.bars)
    notes = "<br>".join(note for note in (picture.note, picture.warning) if note)
    return (
        f'<main style="--n: {len(picture.names)}; --aspect: {picture.aspect:.3f}"><div class="stage">'
        f'<div class="frame"><div class="content"></div><div class="names">{names}</div></div></div>'
        f'<div class="legend">{bars}<div>{notes}<br><span class="dim">drag to turn, scroll or pinch to zoom'
        f"</span></div></div></main><script>{SCRIPT}</script>"
    )


def _bar(bar: Bar) -> str:
    """HTML of a colour bar."""
    labels = "".join(
        f'<span style="left:{100 * (value - bar.low) / (bar.high - bar.low):.2f}%">{words}</span>'
        for value, words in bar.labels.items()
    )
    gradient = ", ".join(bar.colours[::6] + bar.colours[-1:])
    return (
        f'<div class="bar">{bar.title}<div style="background:linear-gradient(to right, {gradient})"></div>'
        f'<div class="labels">{labels}</div></div>'
    )


def save_film(picture: DeformedPicture, path: Path, done: Callable[[], None]) -> None:
    """Write an MP4 of the load rising from zero; `done` is called after each frame."""
    import imageio

    with scratch() as folder:
        made = folder / path.name
        try:
            with imageio.get_writer(made, fps=RATE, quality=8) as film:
                for share in np.linspace(0.0, 1.0, FRAMES - HELD).tolist() + HELD * [1.0]:
                    picture.press(share)
                    picture.plotter.render()  # a screenshot alone takes the last picture again
                    film.append_data(picture.plotter.screenshot(return_img=True))
                    done()
            content = made.read_bytes()
        except OSError:  # ffmpeg's own page about it
            content = b""
        if b"moov" not in content:  # the table that ffmpeg writes last of all
            raise NotWrittenError(
                f"{path}: ffmpeg could not write the film in {folder.parent}: is that disk full, or the size of files "
                "limited (ulimit -f)? Make room or set TMPDIR."
            )
    write_bytes(path, content)


def save_blocks(panels: Mapping[str, Parts], path: Path) -> None:
    """Write parts at rest with displacement and stress at their points: a VTM file and a folder of the same name."""
    with replacing(path) as temporary:
        folder = Path(os.path.realpath(path)).with_suffix("")
        files = temporary.parent / "parts"
        files.mkdir()
        index = ElementTree.Element("VTKFile", type="vtkMultiBlockDataSet", version="1.0")
        top, count = ElementTree.SubElement(index, "vtkMultiBlockDataSet"), itertools.count()
        for place, (panel, parts) in enumerate(panels.items()):
            block = top if len(panels) == 1 else ElementTree.SubElement(top, "Block", index=str(place), name=panel)
            for number, (name, part) in enumerate(parts.items()):
                file = files / f"{next(count)}.vtu"
                file.write_bytes(vtk_content(_with_fields(part)))
                attributes = {"index": str(number), "name": name, "file": f"{folder.name}/{file.name}"}
                ElementTree.SubElement(block, "DataSet", attributes)
        temporary.write_bytes(ElementTree.tostring(index, xml_declaration=True))
        if folder.exists():
            shutil.rmtree(folder)
        files.replace(folder)


def _with_fields(part: Part) -> pv.UnstructuredGrid:
    """A part at rest with its fields."""
    grid = part.grid
    grid.point_data["displacement_mm"] = part.displacement_mm
    if part.stress_mpa is not None:
        grid.point_data["stress_mpa"] = part.stress_mpa
        grid.point_data["von_mises_mpa"] = von_mises(part.stress_mpa)
        grid.point_data["pressure_mpa"] = pressure(part.stress_mpa)
    if part.traction_mpa is not None:
        grid.cell_data["traction_mpa"] = part.traction_mpa
    return grid


#: by suffix of the file: the medium that the picture is drawn for, and the function that writes it
SAVERS: dict[str, tuple[Medium, Callable[[DeformedPicture, Path, Callable[[], None]], None]]] = {
    ".png": ("file", save_png),
    ".html": ("page", save_html),
    ".mp4": ("film", save_film),
}
