"""Contracts that every job keeps, walked over the table of jobs: help, JSON, and the same refusals from Python."""

import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest

import tripillar as tp
from tests.docs.terminal import ROOT
from tests.fem.scenes import BLOCK
from tests.house import House
from tests.tripillar.made_files import a_dataset, a_model
from tripillar.cli.app import COMMANDS, GONE, app_of, job_of
from tripillar.cli.door import command_of, flag_of, spelled
from tripillar.cli.help import meaning, options_of
from tripillar.face.inputs import COUNTS, TIMES

APP = app_of()
NAMES = [name for names in COMMANDS.values() for name in names]
OPTIONS = {name: options_of(APP, name) for name in NAMES}
PARAMETERS = {name: dict(inspect.signature(command_of(job_of(name))).parameters) for name in NAMES}
MAX_COMMANDS = 21
MODEL, DATA = {"model": "model.safetensors"}, {"data": "data.nc"}
#: what a job must be given
NEEDED = {
    "cad": {"out": "solids"}, "solve": {"scene": "block.toml"}, "response": {"out": "r.nc"},
    "press": {"shape": "sphere", "radius_mm": 5.0, "depth_mm": 0.1},
    "dataset": {"protocol": "contact", "samples": 5, "out": "x.nc"}, "train": DATA | {"out": "m.safetensors"},
    "evaluate": MODEL | DATA, "identify": DATA | {"out": "m.safetensors"}, "export": {"out": "m.h"} | MODEL,
    "view": {"save": "p.png"}, "sweep": {"file": "block.toml"}, "live": {"port": "text.txt"} | MODEL,
    "record": {"port": "text.txt", "out": "y.frames"}, "replay": {"recording": "text.txt"} | MODEL,
    "tare": {"port": "text.txt", "out": "x.json"}, "info": {"port": "text.txt"}, "board": {"chip": "python"},
}  # fmt: skip
WRITTEN = {"out", "twin", "vtu", "picture", "save", "mcap", "rrd", "keep", "link", "truth"}


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("contracts"))
    (house.folder / "block.toml").write_text(BLOCK)
    (house.folder / "text.txt").write_text("hello\n")
    a_dataset(house.folder / "data.nc")
    a_model(house.folder / "model.safetensors")
    return house


def kinds(parameter):
    """Types of a parameter, None apart."""
    hint = get_args(parameter.annotation)[0]
    members = [hint] if get_origin(hint) in (None, Literal) else get_args(hint)
    return [each for each in members if each is not type(None)]


def typed(name, given):
    """What is typed to give a job these."""
    words = [name]
    for parameter, value in given.items():
        known = PARAMETERS[name][parameter]
        flags = get_args(known.annotation)[1].name or (flag_of(parameter),)
        words += [] if known.kind is known.POSITIONAL_ONLY else [flags[0]]
        words += [] if value is True else [str(value)]
    return words


def called(name, given):
    """Call the job of Python."""
    job, known = job_of(name), PARAMETERS[name]
    first = [value for key, value in given.items() if known[key].kind is known[key].POSITIONAL_ONLY]
    result = job(*first, **{key: value for key, value in given.items() if value not in first})
    if hasattr(result, "__enter__"):
        result.__enter__()


def wrong_values():
    """Whatever every job refuses alike: files that are not there, times and counts that are none."""
    for name, parameters in PARAMETERS.items():
        for key, parameter in parameters.items():
            if Path in kinds(parameter) and key not in WRITTEN:
                yield name, key, "missing.toml", "missing.toml: no such file"
            elif key in TIMES and name != "board":
                yield name, key, 0.0, "must be above 0"
            elif key in COUNTS and int in kinds(parameter):
                yield name, key, 0, "must be at least 1"


@pytest.mark.parametrize(("name", "key", "value", "says"), list(wrong_values()))
def test_a_mistake_is_refused_alike_in_python_and_as_typed(house, name, key, value, says, monkeypatch):
    monkeypatch.chdir(house.folder)
    given = NEEDED.get(name, {}) | {key: value}
    said = house.refusal(*typed(name, given))
    assert says in said
    with pytest.raises(tp.TriPillarError) as refused:
        called(name, given)
    flags = {each: flag_of(each) for each in PARAMETERS[name]}
    assert said == f"tripillar: {spelled(str(refused.value), flags)}"


@pytest.mark.parametrize("words", ["train --data missing.nc -o m.safetensors", "evaluate --data missing.nc --folds 2"])
def test_a_missing_file_is_refused_before_any_stage_is_loaded(house, words):
    """Those take seconds."""
    code = f"import sys\nsys.argv[1:] = {words.split()!r}\nfrom tripillar.cli.app import main\n"
    code += "try: main()\nexcept SystemExit: print('scipy' in sys.modules)"
    environment = house.environment | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=house.folder, env=environment, capture_output=True, text=True
    )
    assert (done.stdout, "missing.nc: no such file" in done.stderr) == ("False\n", True), done.stderr


@pytest.mark.parametrize("name", NAMES)
def test_what_is_missing_unknown_no_choice_or_no_number_is_refused_and_every_parameter_is_told(house, name):
    said = house.refusal(name, "--no-such-flag")
    required = [flag for entry in OPTIONS[name] if entry.required for flag in entry.all_options]
    assert "Unknown option: --no-such-flag" in said or any(f"{flag} is missing: " in said for flag in required)
    told = inspect.getdoc(job_of(name))
    for given in inspect.signature(job_of(name)).parameters.values():
        assert given.kind is given.VAR_KEYWORD or re.search(rf"\b{given.name}\b", told), given.name
    for key, parameter in PARAMETERS[name].items():
        (kind, *_) = kinds(parameter)
        wrong, must = ("abc", "must be a number") if kind is float else ("1.5", "must be a whole number")
        if get_origin(kind) is Literal:
            wrong, must = "magic", f"must be one of {', '.join(get_args(kind))}"
        elif kind not in (int, float):
            continue
        said = house.refusal(*typed(name, NEEDED.get(name, {}) | {key: wrong}))
        assert f" {wrong} {must}. See 'tripillar {name} --help'." in said


@pytest.mark.parametrize("width", [80, 120])
def test_help_prints_every_word_as_written(house, monkeypatch, width):
    """A unit in brackets, such as [s], is no markup; an option's help begins with a noun or a verb, not with "Of"."""
    monkeypatch.setitem(house.environment, "COLUMNS", str(width))
    overview = "".join(house.tripillar("--help").stdout.split())
    for name in NAMES:
        done = house.tripillar(name, "--help")
        assert done.returncode == 0
        assert all(len(line) <= width for line in done.stdout.splitlines()), name
        summary = APP[name].help.strip().partition("\n")[0]
        assert re.match(r"[A-Z].*\.$", summary), name
        shown = "".join(done.stdout.split())
        assert "".join(f"{name}{summary}".split()) in overview, name
        for entry in OPTIONS[name]:
            told = meaning(entry)
            assert told[0].isupper(), (name, told)
            assert told.split()[0] not in ("Of", "In", "For", "Its", "True", "False", "As"), (name, told)
            assert all("".join(word.split()) in shown for word in (*told.split(), *entry.all_options)), (name, told)


def test_flags_are_the_same_everywhere():
    """-o is --out; who can be quiet can talk; what draws or solves is told for which design."""
    assert len(NAMES) <= MAX_COMMANDS
    flags = {name: {flag for entry in OPTIONS[name] for flag in entry.all_options} for name in NAMES}
    for name, given in flags.items():
        assert {"--json", "-q", "-v", "--quiet", "--verbose"} <= given, name
        assert ("-o" in given) == ("--out" in given), name
        assert given == {flag.lower() for flag in given}, name
    for name in ("cad", "response", "dataset", "run", "view", "board", "identify", "train", "evaluate", "press"):
        assert "--design" in flags[name], name


@pytest.mark.parametrize("name", GONE)
def test_a_command_that_is_gone_says_the_new_one(house, name):
    line = house.refusal(*name.split(), "--whatever")
    assert line.startswith(f"tripillar: {name} is gone: write tripillar ")
    assert line.split("write tripillar ")[1].split()[0].rstrip(".;") in NAMES
