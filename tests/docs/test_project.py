"""What a project states of itself: how to cite it, how to contribute, what the forges run."""

import re
import tomllib

import yaml

from studies.pictures.gallery import sections
from tests.docs.terminal import ROOT


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_is_of_this_version():
    """Its keys are those that the Citation File Format 1.2.0 asks for; title and version are the package's."""
    project, citation = tomllib.loads(read("pyproject.toml"))["project"], yaml.safe_load(read("CITATION.cff"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert str(citation["version"]) == project["version"]
    assert citation["title"] == f"TriPillar: {project['description']}"
    assert [author["name"] for author in citation["authors"]] == [author["name"] for author in project["authors"]]
    (paper,) = citation["references"]
    assert f"https://doi.org/{paper['doi']}" == project["urls"]["The paper"]


def test_the_contribution_guide_names_what_is_there():
    guide = read("CONTRIBUTING.md")
    paths = re.findall(r"\]\(([^)#]+)", guide) + re.findall(r"`((?:\w+/)+[\w.-]*)`", guide)
    assert len(paths) > 12
    assert not [path for path in paths if not (ROOT / path).exists()]
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z-]+)", guide)) <= targets


def test_the_gallery_has_ten_small_pictures_each_with_its_command():
    page = read("docs/gallery.md")
    shown = [re.findall(r"!\[.+\]\((.+)\)", section) for section in page.split("\n## ")[1:]]
    typed = [re.findall(r"^    (tripillar|python) ", section, re.MULTILINE) for section in page.split("\n## ")[1:]]
    assert len(shown) == 10
    assert all(len(pictures) == 1 and commands for pictures, commands in zip(shown, typed, strict=True))
    paths = [ROOT / "docs" / picture for (picture,) in shown]
    assert all(path.stat().st_size <= 150_000 for path in paths)
    assert set((ROOT / "docs" / "gallery").iterdir()) <= set(paths)
    assert {f"gallery/{name}.webp" for name in sections(page)} == {
        one for (one,) in shown if one.startswith("gallery/")
    }


def test_forges_run_the_one_script_and_the_other_systems():
    github, gitlab = yaml.safe_load(read(".github/workflows/ci.yml")), yaml.safe_load(read(".gitlab-ci.yml"))
    steps = {name: [step.get("run", "") for step in job["steps"]] for name, job in github["jobs"].items()}
    assert ".ci/run" in steps["linux"]
    assert gitlab["check"]["script"] == [".ci/run"]
    assert {name.split("-")[0] for name in github["jobs"]["others"]["strategy"]["matrix"]["os"]} == {"windows", "macos"}
    assert any("--constraint constraints.txt" in step for step in steps["others"])
    assert any("pytest" in step for step in steps["others"])
