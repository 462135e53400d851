"""A picture as a file: PNG, a page, a film, or parts with their fields for ParaView."""

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyvista as pv

from fem.fields.deformed import Parts
from fem.fields.stress import pressure, von_mises
from fem.pictures.deformation import DeformedPicture, Medium, grid_of
from geometry.errors import NotWrittenError
from geometry.storage.files import replacing, scratch, write_bytes
from geometry.storage.vtk_file import vtk_content
from tripillar.viewer.saved_page import own_page

FRAMES, HELD, RATE = 78, 18, 24  #: of a film: all, those of them that hold the whole load, and how many a second


def save_png(picture: DeformedPicture, path: Path, done: Callable[[], None]) -> None:
    """Write a PNG."""
    with replacing(path) as temporary:
        picture.plotter.screenshot(temporary)
    done()


def save_html(picture: DeformedPicture, path: Path, done: Callable[[], None]) -> None:
    """Write a page to turn the picture in, with all that it needs inside: it opens without a network."""
    import asyncio

    from trame.app import get_server
    from trame.widgets import vtk

    server = get_server(pv.global_theme.trame.jupyter_server_name)  # where PyVista looks for it
    vtk.initialize(server)

    async def exported() -> str:
        """The page, as a server on loopback that nobody else is told of makes it."""
        server.start(
            exec_mode="task", host="127.0.0.1", port=0, open_browser=False, show_connection_info=False,
            disable_logging=True, timeout=0, backend="aiohttp",
        )  # fmt: skip
        await server.ready
        try:
            return picture.plotter.trame.export_html(None).getvalue()
        finally:
            await server.stop()

    page = asyncio.run(exported())
    with replacing(path) as temporary:
        temporary.write_text(own_page(page, picture), encoding="utf-8")
    done()


def save_film(picture: DeformedPicture, path: Path, done: Callable[[], None]) -> None:
    """Write an MP4 of the load rising from nothing; `done` is called after each frame."""
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
    """Parts at rest with displacement and stress at their points, as VTM and a folder of the same name."""
    blocks = pv.MultiBlock({name: pv.MultiBlock(_datasets(parts)) for name, parts in panels.items()})
    if len(panels) == 1:
        blocks = blocks[0]
    with replacing(path) as temporary:
        folder = Path(os.path.realpath(path)).with_suffix("")
        parts = temporary.parent / "parts"
        parts.mkdir()
        index = ElementTree.Element("VTKFile", type="vtkMultiBlockDataSet", version="1.0")
        _write_blocks(blocks, ElementTree.SubElement(index, "vtkMultiBlockDataSet"), parts, folder.name)
        temporary.write_bytes(ElementTree.tostring(index, xml_declaration=True))
        if folder.exists():
            shutil.rmtree(folder)
        parts.replace(folder)


def _write_blocks(blocks: pv.MultiBlock, parent: ElementTree.Element, parts: Path, folder: str) -> None:
    """Write each grid as a file into `parts` and its name, as one in `folder`, under the XML element `parent`."""
    for number, name in enumerate(blocks.keys()):
        block = blocks[number]
        if isinstance(block, pv.MultiBlock):
            inner = ElementTree.SubElement(parent, "Block", index=str(number), name=str(name))
            _write_blocks(block, inner, parts, folder)
        else:
            kind = "vtp" if isinstance(block, pv.PolyData) else "vtu"
            file = parts / f"{len(list(parts.iterdir()))}.{kind}"
            file.write_bytes(vtk_content(block))
            ElementTree.SubElement(parent, "DataSet", index=str(number), name=str(name), file=f"{folder}/{file.name}")


def _datasets(parts: Parts) -> dict[str, pv.DataSet]:
    found = {}
    for name, part in parts.items():
        grid = grid_of(part)
        grid.point_data["displacement_mm"] = part.displacement_mm
        if part.stress_mpa is not None:
            grid.point_data["stress_mpa"] = part.stress_mpa
            grid.point_data["von_mises_mpa"] = von_mises(part.stress_mpa)
            grid.point_data["pressure_mpa"] = pressure(part.stress_mpa)
        if part.traction_mpa is not None:
            grid.cell_data["traction_mpa"] = part.traction_mpa
        found[name] = grid
    return found


#: what a picture for each kind of file is drawn for, and what writes it
SAVERS: dict[str, tuple[Medium, Callable[[DeformedPicture, Path, Callable[[], None]], None]]] = {
    ".png": ("file", save_png),
    ".html": ("page", save_html),
    ".mp4": ("film", save_film),
}
