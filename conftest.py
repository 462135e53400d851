"""Fixtures of every test: a cache of its own or one shared by all, folders that are filled once, and Ctrl-C."""

import gc
import itertools
import os
import pickle
import re
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import filelock
import pytest
from hypothesis.configuration import set_hypothesis_home_dir
from hypothesis.internal.conjecture import providers

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before NumPy loads: the cores belong to pytest's workers
if "PYTEST_XDIST_WORKER" not in os.environ:  # the workers inherit the first process's environment
    _scratch = tempfile.TemporaryDirectory(prefix="tripillar-tests-")
    os.environ["TRIPILLAR_TESTS"] = _scratch.name
    os.environ["TRIPILLAR_CACHE"] = f"{_scratch.name}/cache"  # of fixtures that live longer than one test
NUMBERS = itertools.count()
SHARED = Path(os.environ["TRIPILLAR_TESTS"])  #: folder of all tests of a session, in whatever process they run
LONG_FIRST = ("tests/docs/", "tests/studies/", "tests/tripillar/")
#: what tests name that Windows cannot run: pseudo-terminals, the firmware, signals and files of POSIX, the laboratory
POSIX = re.compile(
    r"\b(PythonBoard|SimavrBoard|tp\.board|boards|pty|openpty|preexec_fn|mkfifo|chmod|getuid|os\.uname|room_for)\b"
    r"|SIGKILL|SIGSTOP|SIGUSR|\"board\"|import studies|from studies"
)
HERE = Path(__file__).parent
FLOORS = ("common", "geometry", "fem", "dataset", "decoupler", "hardware", "tripillar", "studies")
NOT_COLLECTED = {
    path
    for path in (*HERE.glob("tests/**/test_*.py"), *HERE.glob("hardware/boards/*.py"))
    if sys.platform == "win32" and POSIX.search(path.read_text(encoding="utf-8"))
} | (
    {HERE / "studies", *(HERE / f"tripillar/face/{name}.py" for name in ("boards", "simulating"))}
    if sys.platform == "win32"
    else set()
)
# every worker would import them to look for examples
NOT_COLLECTED |= {
    path for floor in FLOORS for path in (HERE / floor).rglob("*.py") if ">>>" not in path.read_text(encoding="utf-8")
}
# in each worker, hypothesis would parse every module of the house for numbers that its examples might be
providers._get_local_constants = lambda: providers._local_constants
# hypothesis starts to write while tests are still being collected, before any fixture
set_hypothesis_home_dir(SHARED / "hypothesis")


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """As `collect_ignore` would, which resolves all of its paths for every file: 3 s a worker."""
    return True if collection_path in NOT_COLLECTED else None


def pytest_collect_file(file_path: Path) -> None:
    """Import a floor's module by its name before pytest does by its file: one that its package imports is there then.

    Else it would stand there twice, and what a test patches by name would be another copy than what it calls.
    """
    *package, name = file_path.with_suffix("").relative_to(HERE).parts if file_path.is_relative_to(HERE) else ("",)
    if package and package[0] in FLOORS:
        with suppress(ImportError):  # pytest says so
            import_module(".".join([*package, *[name] * (name != "__init__")]))


def pytest_unconfigure() -> None:
    if "PYTEST_XDIST_WORKER" not in os.environ:
        _scratch.cleanup()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage in what there is after it: it is little, and each look takes a twentieth of the time."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.enable()
    return result


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the folders of long tests, so that no worker is left with one in the end."""
    items.sort(key=lambda item: not item.nodeid.startswith(LONG_FIRST))


@pytest.fixture(autouse=True)
def own_cache(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give each test a cache of its own, so that no test finds what another has left there; examples share theirs.

    Only its name is made: most tests keep nothing there, and thousands of folders take a minute.
    """
    is_example = isinstance(request.node, pytest.DoctestItem)
    cache = SHARED / ("cache" if is_example else f"cache-{os.getpid()}-{next(NUMBERS)}")
    monkeypatch.setenv("TRIPILLAR_CACHE", str(cache))
    return cache


@pytest.fixture
def shared_cache(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a test reuse what others have solved; not for tests that change how it is solved, or look into the cache."""
    monkeypatch.setenv("TRIPILLAR_CACHE", str(SHARED / "cache"))


@pytest.fixture
def coarse(own_cache: Path) -> Iterator[None]:
    """Let a test reuse arrays that others have solved coarsely: where how well is not on trial."""
    from tests.house import coarse

    with coarse():
        yield


@pytest.fixture(autouse=True)
def quick_examples(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Examples of Python's names show what these give: of coarse arrays, and without processes that load torch."""
    if request.node.nodeid.startswith("tripillar/"):
        from tests.studies.one_process import one_after_another

        request.getfixturevalue("coarse")
        monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", one_after_another)


@pytest.fixture
def few_potentials(shared_cache: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Conduction at finite strain by two typical samples on a coarse mesh, in seconds: at rest it is as exact."""
    monkeypatch.setattr("fem.finite.samples.TYPICAL", 2)
    monkeypatch.setattr("fem.finite.samples.TYPICAL_METHOD", "few")
    monkeypatch.setattr("fem.conduction.reduced.MESH", (2, 1, False))


@pytest.fixture(scope="session")
def made_once() -> Callable[[str, Callable[[Path], object]], Path]:
    """Fill a named folder once a session; other tests and processes wait for it and then find it filled."""

    def made_once(name: str, fill: Callable[[Path], object]) -> Path:
        folder, filled = SHARED / name, SHARED / f"{name}.filled"
        with filelock.FileLock(f"{folder}.lock"):
            if not filled.exists():
                folder.mkdir(exist_ok=True)
                fill(folder)
                filled.touch()
        return folder

    return made_once


@pytest.fixture(scope="session")
def pair_field(made_once: Callable[[str, Callable[[Path], object]], Path]) -> object:
    """The field of the paper's unit twice, 1 × 2, ready to be loaded: an `ArrayField`, its cell solved once."""
    from fem.array.coupled_cells import CoupledArray
    from fem.pictures.arrays import solve_array_field
    from geometry.design import Array, SensorDesign

    def solve(folder: Path) -> None:  # without its factor, which holds memory of this process's solver
        field = replace(solve_array_field(SensorDesign(array=Array(rows=1, cols=2))), coupled=None)
        (folder / "field.pickle").write_bytes(pickle.dumps(field))

    field = pickle.loads((made_once("pair-field", solve) / "field.pickle").read_bytes())
    return replace(field, coupled=CoupledArray(field.interior.cell, 1, 2))


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> Iterator[None]:
    """Let Ctrl-C interrupt what tests start, also in the background of a shell, where it would be ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def leaves_ctrl_c_alone(interruptible: None) -> Iterator[None]:
    """A test that left Ctrl-C to another handler, or held back, would make later ones fail in turn: it is named."""
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert sys.platform == "win32" or signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
