"""Contracts that every job keeps, walked over the table of jobs; and a table of what else is refused."""

import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest

import tripillar as tp
from tests.docs.terminal import ROOT
from tests.fem.scenes import BLOCK
from tests.house import SMALL, House
from tests.tripillar.made_files import a_dataset, a_model
from tripillar.cli.commands import COMMANDS, GONE, job_of
from tripillar.cli.door import flag_of, spelled
from tripillar.cli.help import meaning, options_of
from tripillar.cli.parser import app_of, parsed
from tripillar.cli.plain import typed_plainly
from tripillar.face.inputs import COUNTS, TIMES
from tripillar.face.streaming import FILES

APP = app_of()
NAMES = [name for names in COMMANDS.values() for name in names]
OPTIONS = {name: options_of(APP, name) for name in NAMES}
PARAMETERS = {name: dict(inspect.signature(parsed(job_of(name))).parameters) for name in NAMES}
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
    "tare": {"port": "text.txt", "out": "x.json"},
    "rubber": {"next_test": "next.csv"}, "info": {"port": "text.txt"}, "board": {"chip": "python"},
}  # fmt: skip
WRITTEN = {"out", "twin", "vtu", "picture", "save", "keep", "link", "truth", "next_test", *FILES}
FILES = {
    "unknown.toml": "[array]\nrowz = 3\n",
    "sphere.toml": "[body]\nkind = 'sphere'\n",
    "idle.toml": "[body]\nkind = 'block'\nsize_mm = [9, 9, 9]\n[material]\nyoung_mpa = 1\npoisson = 0.3\n",
    "block.toml": BLOCK,
    "vary.toml": "[vary]\nkey = 'array.pitch_mm'\n",
    "small.toml": SMALL,
    "stiff.toml": SMALL + "[pad]\nkind = 'stiff'\n",
    "square.toml": SMALL.replace("rows = 1", "rows = 3").replace("cols = 2", "cols = 3"),
    "semi.csv": "fz_n_0_0;r_0_0\n1,5;2\n",
    "bare.csv": "time_s,force_n,resistance_ohm\n0,1,2\n",
    "text.txt": "hello\n",
    "text.json": "hello\n",
}


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A folder with files of every kind, most of them bad."""
    house = House(tmp_path_factory.mktemp("contracts"))
    folder = house.folder
    (folder / "dir").mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    a_dataset(folder / "data.nc")
    a_dataset(folder / "few.nc", samples=3)
    a_dataset(folder / "wide.nc", pitch_mm=17)
    whole = (folder / "data.nc").read_bytes()
    (folder / "cut.nc").write_bytes(whole[: len(whole) * 2 // 3])
    a_model(folder / "model.safetensors")
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


PLAIN = {Path: ["a.toml"], str: ["word"], int: ["7"], float: ["-0.5", "0.25"]}  #: a negative number is not plain


@pytest.mark.parametrize("name", NAMES)
def test_what_is_typed_plainly_is_read_as_the_parser_does(name):
    """Each flag alone and its opposite, beside what the command must be given; what is not plain is left to it."""
    job, start = job_of(name), typed(name, NEEDED.get(name, {}))
    plain = 0
    for key, parameter in PARAMETERS[name].items():
        mark, found = get_args(parameter.annotation)[1], kinds(parameter)
        values = get_args(found[0])[-1:] if get_origin(found[0]) is Literal else PLAIN.get(found[0], ["1"])
        more = [[flag, value] for flag in mark.name or () for value in values] if found != [bool] else []
        more += [[flag] for flag in (*(mark.name or ()), *mark.negative)] if found == [bool] else []
        for words in ([*start, *each] for each in ([], *more) if not {key} & NEEDED.get(name, {}).keys()):
            given = typed_plainly(job, words[1:])
            if given is not None:
                _, bound, _ = APP.parse_args(words, exit_on_error=False, print_error=False)
                assert (tuple(given[0]), given[1]) == (bound.args, bound.kwargs), words
                plain += 1
    assert plain
    for words in (["--help"], [*start[1:], "--json", "--json"], [*start[1:], "--no-such-flag"], [*start[1:], "-0.5"]):
        assert typed_plainly(job, words) is None, words


def test_a_missing_file_is_refused_before_any_stage_is_loaded(house):
    """Those take seconds."""
    code = "import sys\nsys.argv[1:] = 'evaluate --data missing.nc --folds 2'.split()\n"
    code += "from tripillar.cli.app import main\ntry: main()\nexcept SystemExit: print('scipy' in sys.modules)"
    settings = {"cwd": house.folder, "env": house.environment | {"PYTHONPATH": str(ROOT)}}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **settings)
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
        (kind, *others) = kinds(parameter)
        wrong, must = ("abc", "must be a number") if kind is float else ("1.5", "must be a whole number")
        if get_origin(kind) is Literal:
            wrong, must = "magic", f"must be one of {', '.join(get_args(kind))}"
        elif kind not in (int, float):
            continue
        pair = [wrong] if others == [float] else []
        said = house.refusal(*typed(name, NEEDED.get(name, {}) | {key: wrong}), *pair)
        assert f" {wrong} {must}. See 'tripillar {name} --help'." in said


def test_help_prints_every_word_as_written(house, monkeypatch):
    """A unit in brackets, such as [s], is no markup; an option's help begins with a noun or a verb, not with "Of"."""
    monkeypatch.setitem(house.environment, "COLUMNS", "80")
    overview = "".join(house.tripillar("--help").stdout.split())
    for name in NAMES:
        done = house.tripillar(name, "--help")
        assert done.returncode == 0
        assert all(len(line) <= 80 for line in done.stdout.splitlines()), name
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


#: a command as it is typed and, after ``->``, words of the line that it must end in
REFUSED = """
--nonsense -> Unknown command '--nonsense'
design extra -> unexpected extra argument: extra. See 'tripillar design --help'
design --out dir -> dir is a folder: give the name of a file in it
design --out small.toml/under/a/file.toml -> small.toml
design --rows 0 -> --rows 0 must be from 1 to 255
cad --out cad --design unknown.toml -> unknown key 'rowz' in [array]; known are rows, cols, pitch_mm
cad --out cad --design data.nc -> data.nc: not a text file
solve small.toml -> the table [body] is missing
solve idle.toml --json --vtu never.vtu -> add a [[probe]]
response --out r.nc --design small.toml --tolerance 0 -> --tolerance 0 must be above 0 and below 1
response --out r.csv --design small.toml -> --out r.csv must be a file that ends in .nc
press --depth 0.5 --design small.toml --shape sphere -> needs --radius
press --shape sphere --radius 5 --depth 1 --length 3 -> --length is not of --shape sphere, which takes --radius.
dataset --samples 5 -o x.nc -> --protocol is missing: one of independent-fz, independent-fx, contact-fz
dataset --protocol contact --samples 99999999999999999999999 -o x.nc -> must be from 1 to 1e+09
dataset --protocol contact --samples 5 -o data.nc --design data.nc -> data.nc is read by this command
dataset --protocol contact --samples 5 -o x.txt -> --out x.txt must be a file that ends in .nc or .zarr
dataset --protocol contact --samples 5 -o x.zarr --only force,ohm -> no variable 'ohm'; there are traction, force,
dataset --protocol contact --samples 5 -o x.nc --workers 2 -> belong to --strain finite and to directories
dataset --protocol contact --samples 1000000000 -o x.nc -> end the file's name in .zarr, or keep less of them by --only
dataset --protocol contact --samples 5 -o x.nc --dead-pillar 9,9,q -> --dead-pillar 9,9,q names no pillar
dataset --protocol contact --samples 5 -o x.nc --design small.toml -q --test-share nan -> --test-share nan of 5 samples
dataset --protocol contact --samples 5 -o x.nc --dead-row 12 -> its row wires are 0 to 11
train --touch --design stiff.toml --shape small.toml -o m.safetensors -> --shape is of bare rubber
train --touch --design small.toml --hidden 3 -o m.safetensors -> presses of its own: leave --hidden out
train --data data.nc wide.nc -o m.safetensors -> data set 2 has another design than the first
train --data data.nc --data wide.nc -o m.safetensors -> data set 2 has another design than the first
train --data data.nc -o m.pt -> --out m.pt must be a file that ends in .safetensors
train --data cut.nc --component fz -o m.safetensors -> cut.nc: truncated or not NetCDF
identify --data semi.csv -o m.safetensors -> semi.csv: has no column force_0_0_x_n of 1 × 1 units
evaluate --data data.nc -> give --model, --predictions, or --folds to cross-validate: one of them
evaluate --model model.safetensors --data wide.nc -> array.pitch_mm: model 15, data 17
evaluate --folds 10 --data few.nc --component all -> 3 samples are too few to cross-validate: at least 4 are needed
identify --data data.nc --port p -o x.safetensors -> give --data or --port, not both
identify --data data.nc -o x.safetensors --pairs 5 -> --pairs 5 must be at most 4: there are no more
identify --data data.nc --design square.toml -o x.safetensors -> data.nc is of 1 × 2 units, the design of 3 × 3
identify --as-designed --data semi.csv --twin t.toml -o x.json -> --as-designed makes no model: leave --twin out
identify --data data.nc -o x.safetensors --noise 0.1 -> --noise goes with --as-designed alone
identify --next 1 --twin t.toml --design small.toml -> --twin needs pairs: give --data or --port too
identify --next 1 --loads semi.csv --design small.toml -> --loads needs pairs: give --data or --port too
identify --next 101 -> --next 101 must be from 0 to 100
identify --as-designed --port text.txt -o x.json -> a recording needs --loads with the columns from_s and to_s
rubber -o r.toml -> give --data of a bench series
rubber --data semi.csv -> semi.csv: the column time_s is missing
rubber --data bare.csv -> bare.csv: the column strain is missing (or strain_pct, displacement_mm); it has time_s,
rubber --data bare.csv --columns speed=v -> --columns speed=... names no quantity
rubber --data bare.csv --check small.toml -o r.toml -> --check judges a rubber that there is
rubber --data bare.csv --wires 3 -> --wires 3 must be 2 or 4
rubber --data bare.csv --out r.csv -> --out r.csv must be a file that ends in .toml
design --extend small.toml -> small.toml: has no table [rubber]
design --extend missing.toml -> missing.toml: no such file
design --extend small.toml --out small.toml -> small.toml is read by this command
design --extend chewing-gum -> neither a rubber file (.toml) nor a published silicone; these are dragon-skin-10,
export data.nc --model model.safetensors -o m.h -> give a data set, a recording or --model FILE, one of them
export text.txt -> of a data set .csv or .parquet, with its design beside; of a recording .nc or .csv. See
export text.txt -o y.txt -> must be a file that ends in .nc or .csv
export text.txt -o y.mcap -> would hold forces: write tripillar replay text.txt --model MODEL --out y.mcap
view small.toml --save x.bmp -> --save x.bmp must end in .png, .html, .mp4, .vtm
view small.toml --save x.png --pressure 0 -> --pressure 0 must be a number in MPa above 0 and at most 100
view small.toml --save x.png --pressure 1MPa -> --pressure 1MPa must be a number in MPa above 0
view block.toml --save x.png --pressure 3 -> has its own loads
view small.toml --host 0.0.0.0 -> add --serve, whose page these are for, or leave --host out
view --serve --host 192.0.2.1 -> cannot listen on 192.0.2.1
view --serve --host 192.0.2.1 -> give another --host or --http-port, or end what listens there
view --serve --port board -> --port needs --model
sweep vary.toml -> 'vary' must be an array of tables, each written [[vary]]
sweep small.toml --trials 3 -> --trials are of a search: add --optimize, or leave --trials out
info missing -> missing: no such port; there are
info missing.frames -> missing.frames: no such file: give a recording
info data.nc -> data.nc: a data set, or an export for other programs
live text.txt --model model.safetensors --rate 20 -> a recording has the rate that it was made at: leave --rate out
live text.txt --model model.safetensors --calibration text.json -> text.json is no calibration
replay text.txt --model model.safetensors --speed 0 -> --speed 0 must be 0.001 or more; 1 is as recorded
tare missing -o text.json -> the file exists: build on it by --calibration
board --board python -q --design small.toml --link small.toml -> --link small.toml exists and is no link
board --pressure 20 --design small.toml --board python -q -> --pressure 20.0 must be from 0 to 10
board --period 0 -> --period 0 must be from 0.1 to 600 s
"""
CASES = [line.split(" -> ") for line in REFUSED.strip().splitlines()]


@pytest.mark.parametrize(("words", "said"), CASES, ids=[words for words, _ in CASES])
def test_a_mistake_is_one_line_and_exit_code_2(house, words, said, monkeypatch):
    monkeypatch.setattr("hardware.session.APPEARS_S", 0.0)
    line = house.refusal(*shlex.split(words))
    assert line.startswith("tripillar: ")
    assert said in line
    assert not any(word in line for word in ("Errno", "Traceback", "codec", "Value error"))
