"""The pictures of docs/gallery.md by its own commands: ``python -m studies draw-gallery docs``.

Each section of the page that shows ``gallery/NAME.webp`` gives the commands that write NAME, a picture. They run in an
empty folder beside copies of scenes/ and examples/; the picture is then made small. Other pictures there are those of
other pages.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from PIL import Image

from common.errors import DesignError
from common.storage.files import cache_folder, replacing

ROOT = Path(__file__).parents[2]
WIDE, MAX_BYTES = 1000, 150_000  #: of a picture
QUALITIES = (90, 75, 60, 45)  #: of WebP, the first that is small enough


def sections(page: str) -> dict[str, list[str]]:
    """Commands of each picture of the gallery, by its name.

    >>> sections("# All\\n\\n## One\\n\\n![it](gallery/one.webp)\\n\\n    tripillar view --save one.png\\n")
    {'one': ['tripillar view --save one.png']}
    """
    found = {}
    for section in page.split("\n## ")[1:]:
        shown = re.search(r"\]\(gallery/([\w-]+)\.webp\)", section)
        if shown:
            found[shown[1]] = re.findall(r"^    (\S.*)$", section, re.MULTILINE)
    return found


def draw(
    docs: Annotated[Path, Parameter(help="Folder of gallery.md, and of gallery/ with its pictures.")],
    only: Annotated[list[str] | None, Parameter(help="Names of the pictures to draw; default: all.")] = None,
) -> None:
    """Run the gallery's commands and keep their pictures."""
    known = sections((docs / "gallery.md").read_text(encoding="utf-8"))
    for name in only or known:
        if name not in known:
            raise DesignError(f"--only {name} is not in the gallery: choose {', '.join(known)}.")
        with tempfile.TemporaryDirectory() as folder:
            drawn = _run(known[name], Path(folder), name)
            shrink(drawn, docs / "gallery" / f"{name}.webp")


def _run(commands: list[str], folder: Path, name: str) -> Path:
    """The picture that commands write into a folder."""
    for kept in ("scenes", "examples"):
        shutil.copytree(ROOT / kept, folder / kept)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TRIPILLAR_CACHE": str(cache_folder().absolute())}
    for command in commands:
        program, *words = shlex.split(command.partition("  #")[0])
        words = ["-m", "tripillar", *words] if program == "tripillar" else words
        done = subprocess.run([sys.executable, *words], cwd=folder, env=environment, check=False)
        if done.returncode:
            raise DesignError(f"{command}: ended with code {done.returncode}.")
    drawn = [path for path in folder.rglob(f"{name}.*") if path.suffix in (".png", ".webp")]
    if len(drawn) != 1:
        raise DesignError(f"gallery.md: the commands of {name} write {len(drawn)} pictures {name}.png or .webp.")
    return drawn[0]


def shrink(drawn: Path, path: Path) -> None:
    """Write a picture as a WebP of at most `MAX_BYTES`, as wide as `WIDE` at most."""
    with Image.open(drawn) as image:
        share = min(1.0, WIDE / image.width)
        size = round(image.width * share), round(image.height * share)
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    with replacing(path) as temporary:
        for quality in QUALITIES:
            small.save(temporary, "WEBP", quality=quality, method=6)
            if temporary.stat().st_size <= MAX_BYTES:
                return
        raise DesignError(f"{path}: more than {MAX_BYTES} bytes at a quality of {QUALITIES[-1]}: draw less.")
