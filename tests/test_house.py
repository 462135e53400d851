"""The layout of the house: imports run one way, pictures are leaves, help loads nothing heavy."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = ["geometry", "fem", "dataset", "decoupler", "hardware", "tripillar", "studies"]  #: each imports only leftwards
HEAVY = ["build123d", "torch", "pyvista", "skfem", "xarray", "scipy", "trimesh"]


def imports(path: Path) -> set[str]:
    """Modules that a file imports, wherever in it, by their dotted names."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def sources() -> list[tuple[str, Path]]:
    files = [(floor, path) for floor in FLOORS for path in sorted((ROOT / floor).rglob("*.py"))]
    return files


@pytest.mark.parametrize(("floor", "path"), sources(), ids=lambda value: getattr(value, "stem", value))
def test_imports_run_one_way(floor, path):
    above = FLOORS[FLOORS.index(floor) + 1 :]
    upward = {name for name in imports(path) if name.split(".")[0] in above}
    assert not upward, f"{path.name} of {floor} imports {sorted(upward)}"


@pytest.mark.parametrize(("floor", "path"), sources(), ids=lambda value: getattr(value, "stem", value))
def test_pictures_are_leaves(floor, path):
    drawn = {name for name in imports(path) if name.split(".")[0] in FLOORS and "figures" in name.split(".")}
    assert floor in ("studies", "tripillar") or not drawn


@pytest.mark.parametrize("command", [[], ["train"], ["dataset"], ["run"]])
def test_help_loads_nothing_heavy(command):
    """What takes seconds to import is not imported to print a help text."""
    code = (
        "import sys\nfrom tripillar.cli.app import main\n"
        f"sys.argv = ['tripillar', *{command!r}, '--help']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', *[name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stderr.strip() == "loaded:"
    assert "Usage" in done.stdout


def test_training_and_replay_load_no_cad_and_no_mesher():
    code = (
        "import sys, decoupler.training.trainer, hardware\n"
        "print(*[name for name in ('build123d', 'skfem', 'pyvista') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == ""
