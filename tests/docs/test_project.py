"""What a project states of itself: how to cite it, how to contribute, what the forges run."""

import re
import tomllib

import yaml

from tests.docs.terminal import ROOT


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_is_of_this_version():
    project, citation = tomllib.loads(read("pyproject.toml"))["project"], yaml.safe_load(read("CITATION.cff"))
    assert str(citation["version"]) == project["version"]


def test_the_contribution_guide_names_what_is_there():
    guide = read("CONTRIBUTING.md")
    paths = re.findall(r"\]\(([^)#]+)", guide) + re.findall(r"`((?:\w+/)+[\w.-]*)`", guide)
    assert len(paths) > 12
    assert not [path for path in paths if not (ROOT / path).exists()]
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z-]+)", guide)) <= targets


def test_forges_run_the_one_script_and_the_other_systems():
    github, gitlab = yaml.safe_load(read(".github/workflows/ci.yml")), yaml.safe_load(read(".gitlab-ci.yml"))
    steps = {name: [step.get("run", "") for step in job["steps"]] for name, job in github["jobs"].items()}
    assert ".ci/run" in steps["linux"]
    assert gitlab["check"]["script"] == [".ci/run"]
    assert any("pytest" in step for step in steps["others"])
