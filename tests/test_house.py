"""The layout of the house: imports run one way, pictures are leaves, files are short, help is light."""

import ast
import json
import os
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.house import SMALL
from tripillar.cli.commands import COMMANDS

ROOT = Path(__file__).parents[1]
FLOORS = [
    "common",
    "geometry",
    "fem",
    "dataset",
    "decoupler",
    "hardware",
    "tripillar",
    "studies",
]  #: each imports only leftwards
HEAVY = ["build123d", "torch", "pyvista", "skfem", "xarray", "scipy", "trimesh"]
MAX_LINES = 450  #: of a file of the product or the laboratory
OTHERS = (".js", ".html", ".msg", ".c", ".h")  #: of files that are not in Python
HELP_S = 1.0  #: of processor time to print a help text
#: rooms of each floor, in the order of the data: none imports one to its right
ROOMS = {
    "common": "storage",
    "fem": "meshes kernel conduction scene finite array contact methods pictures",
    "decoupler": "data rubber inverse model training twin evaluation touch export",
    "hardware": "link recording readout streams virtual boards",
    "tripillar": "terminal pipeline doctor datasets sweeps viewer simulators face cli",
    "studies": "pictures bench paper robustness real_rubber",
}


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def name_of(path: Path) -> str:
    """Dotted name of a module."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def imports(path: Path) -> set[str]:
    """Modules that a file imports, wherever in it, by their dotted names."""
    return imports_of(nodes(path))


def imports_of(found: list[ast.AST]) -> set[str]:
    names = set()
    for node in found:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def upward(folder: str, later: tuple[str, ...]) -> list[str]:
    """What files of a folder import of what comes after it."""
    return [
        f"{name_of(path)} imports {name}"
        for path in sources(folder)
        for name in imports(path)
        if any(name == other or name.startswith(f"{other}.") for other in later)
    ]


def test_no_module_stands_twice():
    """A class is the one that its module's name leads to; by two copies, what a test patches is not what it calls."""
    modules = [module for name, module in list(sys.modules.items()) if name.partition(".")[0] in FLOORS]
    classes = [value for module in modules for value in list(vars(module).values()) if isinstance(value, type)]
    own = [one for one in classes if one.__module__.partition(".")[0] in FLOORS and "." not in one.__qualname__]
    assert [one for one in own if vars(sys.modules[one.__module__]).get(one.__name__, one) is not one] == []


def test_imports_run_one_way():
    """No floor imports one above it, no room a later one: nothing of the product imports the laboratory or tests."""
    wrong = [line for k, floor in enumerate(FLOORS) for line in upward(floor, (*FLOORS[k + 1 :], "tests"))]
    for floor, named in ROOMS.items():
        rooms = named.split()
        assert {path.parent.name for path in (ROOT / floor).glob("*/__init__.py")} == set(rooms)
        for k, room in enumerate(rooms):
            wrong += upward(f"{floor}/{room}", tuple(f"{floor}.{other}" for other in rooms[k + 1 :]))
    assert not wrong


@cache
def loaded(path: Path) -> set[str]:
    """Modules that a file imports when it runs."""
    checkers = [node for node in nodes(path) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    hidden = {each for block in checkers for part in block.body for each in ast.walk(part)}
    return imports_of([node for node in nodes(path) if node not in hidden])


def test_imports_run_in_no_circle():
    """Not within functions, either, where a circle would hide: the error names it."""
    files = {name_of(path): path for path in sources(*FLOORS)}
    TopologicalSorter({name: (loaded(path) & files.keys()) - {name} for name, path in files.items()}).prepare()


def test_pictures_are_leaves():
    """What draws is imported by nobody but tripillar and studies."""
    drawing = ("fem.pictures", "decoupler.rubber.pictures")
    assert not [line for floor in FLOORS[:-2] for line in upward(floor, drawing) if not line.startswith(drawing)]


def test_pages_that_are_pointed_to_are_there():
    """In messages, docstrings and comments."""
    named = {
        (name_of(path), page)
        for path in sources(*FLOORS)
        for page in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8"))
    }
    assert named
    assert not {(name, page) for name, page in named if not (ROOT / page).is_file()}


def test_no_other_file_knows_a_layout_by_heart():
    """Electrodes have their names in `geometry/layout.py`, and in what `wiring.py` says of the paper's."""
    knowing = [ROOT / "geometry/layout.py", ROOT / "geometry/wiring.py"]
    python = [path for path in sources(*FLOORS) if path not in knowing]
    texts = [(path, node.value) for path in python for node in nodes(path) if isinstance(node, ast.Constant)]
    others = [path for folder in FLOORS for path in (ROOT / folder).rglob("*.*") if path.suffix in OTHERS]
    texts += [(path, path.read_text(encoding="utf-8")) for path in others]
    named = re.compile(r"\b[UL][1-9]\b")
    assert not [f"{path}: {text}" for path, text in texts if isinstance(text, str) and named.search(text)]


def test_files_are_short():
    lines = {name_of(path): path.read_text(encoding="utf-8").count("\n") for path in sources(*FLOORS)}
    assert not {name: n for name, n in lines.items() if n > MAX_LINES}


def loaded_by(code: str, names: list[str]) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own that prints to stderr which of the names it loaded."""
    code += f"\nimport sys\nprint(*[name for name in {names!r} if name in sys.modules], file=sys.stderr)"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)


def test_help_loads_nothing_heavy_and_is_printed_at_once():
    """Nothing that takes seconds to import is imported to print a help text."""
    commands = [[], *([name] for names in COMMANDS.values() for name in names)]
    done = loaded_by(
        "import sys\nfrom tripillar.cli.app import main\n"
        f"for command in {commands!r}:\n"
        "    sys.argv = ['tripillar', *command, '--help']\n"
        "    try: main()\n"
        "    except SystemExit as end: assert not end.code, command",
        HEAVY,
    )
    assert done.stderr.strip() == ""
    assert done.stdout.count("Usage") == len(commands)
    before = os.times()
    subprocess.run([sys.executable, "-m", "tripillar", "--help"], capture_output=True, cwd=ROOT, check=True)
    after = os.times()
    assert after.children_user + after.children_system - before.children_user - before.children_system < HELP_S


LEFT_OUT = ["cyclopts", "docstring_parser", "xarray", "pandas", "scipy.interpolate", "scipy.stats", "torch", "pyvista"]
LEFT_OUT += ["scipy.optimize", "scipy.spatial"]
#: typed plainly, and what else none of these loads
PLAIN = {
    f"solve {ROOT}/scenes/block-patch.toml --tolerance 0.05 --json": ["rich", "netCDF4", "fem.conduction", "dataset"],
    "response --design small.toml --out r.nc --method layer --json -q": ["dataset", "decoupler", "fem.conduction"],
}


@pytest.mark.parametrize("typed", PLAIN)
def test_what_is_typed_plainly_loads_neither_a_parser_nor_what_it_does_not_need(typed, tmp_path):
    """Start-up is most of the time of a simple scene, and of whatever is in the cache."""
    (tmp_path / "small.toml").write_text(SMALL)
    code = f"import os, sys\nos.chdir({str(tmp_path)!r})\nsys.argv[1:] = {typed.split()!r}\n"
    code += "from tripillar.cli.app import main\ntry: main()\nexcept SystemExit as end: assert not end.code"
    done = loaded_by(code, [*LEFT_OUT, *PLAIN[typed]])
    assert json.loads(done.stdout)
    assert not {*LEFT_OUT, *PLAIN[typed]} & {*done.stderr.split()}, done.stderr


def test_replay_loads_no_torch_training_no_cad_and_no_mesher_and_loads_on_pads_no_contact():
    assert loaded_by("import hardware", ["fem", "torch", "xarray"]).stderr.strip() == ""
    code, names = "import decoupler.training, hardware, dataset.simulation", ["build123d", "skfem", "pyvista"]
    assert loaded_by(code, [*names, "fem.contact"]).stderr.strip() == ""


#: modules and names that Windows lacks
POSIX_MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
POSIX_NAMES = {
    "os": "fork geteuid getuid killpg openpty posix_fallocate sched_getaffinity set_blocking ttyname",
    "signal": "SIGHUP SIGKILL SIGUSR1 SIGUSR2 alarm pthread_sigmask setitimer",
    "loop": "add_signal_handler remove_signal_handler",
}


def is_posix(node: ast.AST) -> bool:
    if isinstance(node, ast.Import | ast.ImportFrom):
        return bool(POSIX_MODULES & {*(alias.name for alias in node.names), getattr(node, "module", "")})
    is_name = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    return is_name and node.attr in POSIX_NAMES.get(node.value.id, "").split()


def test_what_only_posix_has_is_guarded():
    """A function that uses it asks for the system: what is no pseudo-terminal works on Windows, too."""
    bare = []
    for path in sources(*FLOORS[:-1]):
        functions = [each for each in nodes(path) if isinstance(each, ast.FunctionDef)]
        for node in filter(is_posix, nodes(path)):
            around = [each for each in functions if each.lineno <= node.lineno <= (each.end_lineno or 0)]
            asked = ast.unparse(around[-1] if around else nodes(path)[0])
            if not ("sys.platform" in asked or "hasattr" in asked):
                bare.append(f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}")
    assert not bare, "\n".join(bare)
