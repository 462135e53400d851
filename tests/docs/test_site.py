"""`make docs`: the pages are built without a warning, need nothing from elsewhere and hold every public name."""

import os
import re
import subprocess
import sys

import pytest

import dataset
import decoupler
import fem
import geometry
import hardware
from tests.docs.terminal import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


def test_the_pages_are_built_without_a_warning(site):
    """Every page of docs/ is there."""
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")}
    assert pages
    assert all((site / page).is_file() for page in pages)
    assert not list(site.rglob("*.py"))


def test_nothing_is_loaded_from_elsewhere(site):
    """Scripts, styles, fonts and pictures are the site's own files; pictures exist."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"([^\"]+)\"", text)
        links = re.findall(r"<link\b[^>]*>", text)
        loaded += [re.search(r"href=\"([^\"]+)\"", link)[1] for link in links if 'rel="canonical"' not in link]
        for place in loaded:
            assert not re.match(r"(?:https?:)?//", place), f"{page.name} loads {place}"
            if page.name != "404.html" and not place.startswith("data:"):
                assert (page.parent / place.partition("?")[0]).is_file(), f"{page.name} lacks {place}"


def test_public_names_are_on_their_pages(site):
    errors = (site / "api" / "errors.html").read_text(encoding="utf-8")
    for package in (geometry, fem, dataset, decoupler, hardware):
        text = (site / "api" / f"{package.__name__}.html").read_text(encoding="utf-8") + errors
        for name in package.__all__:
            home = getattr(getattr(package, name), "__module__", "")  # of a function named like its module
            assert f'id="{package.__name__}.{name}"' in text or f'id="{home}.{name}"' in text
