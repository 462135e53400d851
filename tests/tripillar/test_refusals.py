"""Bad input to every command, in this process: exit code 2, one line that says what was given, nothing written.

Each line of `REFUSED` is a command as it is typed and, after ``->``, words of the line that it must end in.
"""

import shlex

import netCDF4
import numpy as np
import pytest

from tests.fem.scenes import BLOCK, PILLAR
from tests.house import SMALL, House
from tests.tripillar.made_files import a_dataset, a_model
from tripillar.cli.app import COMMANDS

FILES = {
    "broken.toml": "[array\n",
    "unknown.toml": "[array]\nrowz = 3\n",
    "tight.toml": "[array]\npitch_mm = 3\n",
    "sphere.toml": "[body]\nkind = 'sphere'\n",
    "idle.toml": "[body]\nkind = 'block'\nsize_mm = [9, 9, 9]\n[material]\nyoung_mpa = 1\npoisson = 0.3\n",
    "pillar.toml": PILLAR,
    "block.toml": BLOCK,
    "key.toml": "[[vary]]\nkey = 'pitch'\n",
    "vary.toml": "[vary]\nkey = 'array.pitch_mm'\n",
    "small.toml": SMALL,
    "empty": "",
    "empty.nc": "",
    "text.txt": "hello\n",
    "text.nc": "hello\n",
    "text.json": "hello\n",
    "text.safetensors": "hello\n",
    "columns.csv": "a,b\n1,2\n",
    "place.csv": "load,row,col,fx_n,fy_n,fz_n\none,5,0,0,0,1\n",
    "letter.csv": "load,row,col,fx_n,fy_n,fz_n\none,0,0,x,0,1\n",
    "größe 🧊.csv": "load,row,col,fx_n,fy_n,fz_n\none,0,0,x,0,1\n",
}

REFUSED = """
designs -> No such command 'designs'. Did you mean 'design'?
frobnicate -> No such command 'frobnicate'
--nonsense -> No such option: --nonsense.
design extra -> unexpected extra argument(s) (extra). See '
design --out -> '--out' requires an argument
design --out dir -> dir is a folder: give the name of a file in it
design --out small.toml/under/a/file.toml -> small.toml
cad -> Missing option '--out'
cad --out cad --design unknown.toml -> unknown key 'rowz' in [array]; known are rows, cols, pitch_mm
cad --out cad --design tight.toml -> raise pitch_mm to at least 12.83
cad --out cad --design broken.toml -> broken.toml: not valid TOML
cad --out cad --design missing.toml -> missing.toml: no such file: write one with 'tripillar design'
cad --out cad --design dir -> dir: a folder, not a file
cad --out cad --design data.nc -> data.nc: not a text file
mesh --quiet=3 -> '--quiet' does not take a value
solve -> Missing argument 'scene'
solve missing.toml -> missing.toml: no such file
solve dir -> dir: a folder, not a file
solve small.toml -> the table [body] is missing
solve sphere.toml -> kind='sphere' is unknown; it must be one of block, pillar, unit, array
solve idle.toml --json --vtu never.vtu -> add a [[probe]]
solve idle.toml --tolerance abc -> --tolerance abc must be a number
solve idle.toml --vtu x.txt -> --vtu x.txt must be a file that ends in .vtu
solve one.toml two.toml -> unexpected extra argument
solve pillar.toml --tolerance 0 -> tolerance=0 must be a number above 0
response --out r.nc --method magic -> --method magic must be one of cells, layer
response --out r.nc --design small.toml --tolerance 0 -> tolerance=0 must be above 0 and below 1
dataset -> Missing option '--protocol'. Choose from: independent-fz, independent-fx
dataset --protocol magic --samples 5 -o x.nc -> --protocol magic must be one of independent-fz,
dataset --protocol contact --samples 1.5 -o x.nc -> --samples 1.5 must be a whole number
dataset --protocol contact --samples 99999999999999999999999 -o x.nc -> must be from 1 to 1000000000
dataset --protocol contact --samples 5 -o small.toml --design small.toml -> small.toml is read by this command
dataset --protocol contact --samples 5 -o x.nc --seed -1 -> seed=-1 must be from 0
dataset --protocol contact --samples 5 -o x.nc --cap 0 -> the paper uses 0.2 and 0.3
dataset --protocol contact --samples 5 -o x.nc --offset=-3 -> offset_ohm=-3 must be
dataset --protocol contact --samples 5 -o x.nc --drift=-0.01 -> drift=-0.01 must be from 0 to 0.5
dataset --protocol contact --samples 5 -o x.nc --drift-tilt 0.6 -> drift_tilt=0.6 must be from 0 to 0.5
dataset --protocol contact --samples 5 -o x.nc --drift-pillar nan -> drift_pillar=nan must be a finite number
dataset --protocol contact --samples 5 -o x.nc --specimen=-1 -> specimen=-1 must be
dataset --protocol contact --samples 5 -o dir.zarr -> dir.zarr is a folder that holds something else
dataset --protocol contact --samples 5 -o file.zarr -> file.zarr is a file: give the name of a folder to be made
dataset --protocol contact --samples 5 -o x.nc --dtype float32 -> --dtype float32 belongs to zarr directories
dataset --protocol contact --samples 5 -o x.zarr --dtype half -> --dtype half must be one of float64, float32
dataset --protocol contact --samples 5 -o x.zarr --only force,ohm -> no variable 'ohm'; there are traction, force,
dataset --protocol contact --samples 5 -o x.zarr --only length -> holds force and resistance at least: name them, too
dataset --protocol contact --samples 5 -o x.nc --workers 2 -> belong to --strain finite and to directories
dataset --protocol contact --samples 5 -o x.zarr --workers 0 -> --workers 0 must be at least 1
dataset --protocol contact --samples 5 -o x.zarr --workers 2 --scheduler tcp://localhost:1 -> give one of them
dataset --protocol contact --samples 1000000000 -o x.nc -> end the file's name in .zarr, or keep less of them by --only
dataset --protocol contact --samples 5 -o x.nc --noise 5 -> noise=5 must be from 0 to 0.1
dataset --protocol contact --samples 5 -o x.nc --bits 40 -> bits=40 must be a whole number from 4 to 24
dataset --protocol contact --samples 5 -o x.nc --gain-spread 1 -> 0.2 is ± 20 %
dataset --protocol contact --samples 5 -o x.nc --dead-pillar 0 -> write row,col,pillar, such as 0,3,z
dataset --protocol contact --samples 5 -o x.nc --dead-pillar 0,6,z -> an array of 6 × 6 units has no pillar 0,6,z
dataset --protocol contact --samples 5 -o x.nc --dead-pillar 0,3,w -> (0, 3, 'w')
dataset --protocol contact --samples 5 -o x.nc --dead-row 12 -> its row wires are 0 to 11
dataset --protocol contact --samples 5 -o x.nc --dead-col=-1 -> dead_cols=(-1,) must hold numbers of wires from 0 on
dataset --protocol contact --samples 5 -o x.nc --switch-ohm 70 -> belong to --crossbar: give it, too
dataset --protocol contact --samples 5 -o x.nc --crossbar divider --sense-ohm 0 -> sense_ohm=0 must be from 1
train -> Missing option
train --data missing.nc --component fz -o m.safetensors -> missing.nc: no such file
train --data cut.nc --component fz -o m.safetensors -> cut.nc: truncated or not NetCDF
train --data nan.nc --component fz -o m.safetensors -> resistance_ohm is nan at sample 7, row 0, col 1, pillar z
train --data data.nc --component fq -o m.safetensors -> --component fq must be one of fz, fx, fy, all
train --data data.nc --component fz -o data.nc -> data.nc is read by this command: give another name
train --data data.nc --component fz -o m.safetensors --hidden 0 -> hidden=0 must be a whole number from 1 up
train --data data.nc --component fz -o m.safetensors --goal -1 -> --goal -1 must be 0 or above; the paper uses 1e-5
train --data data.nc --component fz -o m.safetensors --iterations -1 -> --iterations -1 must be a whole number from 0 up
train --data data.nc --component fz -o m.safetensors --hidden 9999 -> hidden=9999 must be at most 1000
train --data data.nc --component fz -o m.safetensors --design missing.toml -> missing.toml: no such file
evaluate --model missing --data data.nc -> missing: no such file: give a file made by 'tripillar train'
evaluate --model empty --data data.nc -> empty: truncated or no safetensors file
evaluate --model model.safetensors --data wide.nc -> array.pitch_mm: model 15, data 17
evaluate --folds 10 --data data.nc --component all --folds 1 -> folds=1 must be from 2 to 2
evaluate --folds 10 --data few.nc --component all -> 3 samples are too few to cross-validate: at least 4 are needed
identify --data missing.nc -o x.safetensors -> missing.nc: no such file
identify --data data.nc -o x.safetensors --pairs 0 -> --pairs 0 must be at least 1
fine-tune --model model.safetensors -o x.safetensors -> fine-tune is gone: write tripillar identify --data
export --model model.safetensors -o model.txt -> must end in .onnx or .h
export --model model.safetensors -o m.h --precision half -> --precision half must be one of float, double
run --until never -> --until never must be one of dataset, table
run --design unknown.toml --out never -> unknown key 'rowz' in [array]; known are rows, cols, pitch_mm
view small.toml --save x.bmp -> --save x.bmp must end in .png, .html, .mp4, .vtm
view missing.toml --save x.png -> missing.toml: no such file: give a scene or a design
view data.nc --save x.png -> data.nc: not a text file
view small.toml --save x.png --pressure 0 -> --pressure 0 must be above 0 and at most 100 MPa
view --save x.png --pressure nan -> --pressure nan must be above 0
view small.toml --save x.png --pressure 1 1 -> at most 6 different values
view small.toml --save x.png --scale big -> --scale big must be true, auto, or a number
view --save x.png --pressure 1 two -> two: no such file
view --save x.png --colour red -> --colour red must be one of
view --save x.png --camera back -> --camera back must be one of
view --save x.png --load heavy -> --load heavy must be one of
view block.toml --save x.png --pressure 3 -> has its own loads
press --shape sphere --radius 5 -> Missing option '--depth'
press --shape sphere --radius 5 --depth 0 -> must be above 0
view small.toml --host 0.0.0.0 -> add --serve, whose page these are for, or leave --host out
view small.toml --port board -> add --serve, whose page these are for, or leave --port out
view small.toml --serve --save x.png -> the page of --serve has controls of its own: leave --save out
view small.toml --serve --port board -> --port needs --model
view --serve --calibration own.json -> --calibration is of a sensor
view --serve --host 192.0.2.1 -> cannot listen on 192.0.2.1
view --serve --model none.safetensors -> none.safetensors
view small.toml --serve --http-port 99999 -> --http-port 99999 must be from 0
view idle.toml --design small.toml --save x.png -> both say what to show: give one of them
sweep missing.toml -> missing.toml: no such file
sweep small.toml -> unknown key 'extends'; known are design, sweep, vary, bounds
sweep --optimize key.toml -> key.toml: [[vary]] 1: unknown key 'pitch'
sweep vary.toml -> 'vary' must be an array of tables, each written [[vary]]
sweep small.toml --workers 0 -> --workers 0 must be at least 1
sweep --optimize small.toml --trials 0 -> --trials 0 must be at least 1
info one two -> unexpected extra argument(s) (extra). See '
doctor extra -> unexpected extra argument(s) (extra). See '
info -> Missing argument 'PORT'
info '' -> no port was named
info missing -> missing: no such port; there are
info dir -> dir: a folder, not a port
info empty -> the file is empty
info data.nc -> data.nc: not a recording
info foo://bar -> there are no ports of the kind foo://; name a device as /dev/ttyUSB0, or socket://HOST:PORT
info socket://localhost:x -> give socket://HOST:PORT of a running server
info socket://x -> socket://x: no host and port number: give socket://HOST:PORT
info /dev/null -> no serial port
info text.txt --timeout 0 -> --timeout 0 must be above 0 and at most 3600 s
info text.txt --baud fast -> --baud fast must be a whole number
live text.txt --model missing -> missing: no such file
live text.txt --model data.nc -> no safetensors file
live text.txt --model model.safetensors --seconds 0 -> --seconds 0 must be above 0 s
live text.txt --model model.safetensors --rate 20 -> a recording has the rate that it was made at
live text.txt --model model.safetensors --calibration text.json -> text.json is no calibration
info missing --seconds 1 -> missing: no such port
record missing -o y.nc --seconds -1 -> --seconds -1 must be above 0 s
record missing -o y.nc -> record to y.frames, then 'tripillar convert' makes y.nc of it
export missing.frames -o y.nc -> missing.frames: no such file: give a recording
export text.txt -o y.nc -> text.txt: no valid frame in 6 bytes
export text.txt -o y.txt -> must be a file that ends in .nc, .mcap or .csv
export text.nc -o text.nc -> text.nc is read by this command
replay missing.nc --model model.safetensors -> missing.nc: no such file: give a recording
replay missing.nc --model missing --out x.csv -> must be a file that ends in .nc or .mcap
replay text.txt --model model.safetensors -> no valid frame in 6 bytes
replay text.txt --model model.safetensors --out x.csv -> must be a file that ends in .nc or .mcap
replay text.txt --model model.safetensors --speed 0 -> --speed 0 must be 0.001 or more; 1 is as recorded
replay text.txt --model model.safetensors --speed 1 --out x.nc -> --speed only shows forces
replay text.txt --model model.safetensors --speed 1 --no-crosstalk -> --speed only shows forces
replay small.toml --model model.safetensors -> small.toml
replay text.nc --model model.safetensors --out text.nc -> text.nc is read by this command
tare missing -o text.json -> the file exists: build on it by --calibration
tare missing -o x.json --calibration small.toml -> small.toml is no calibration
identify --as-designed --port text.txt -o x.json -> give either --loads FILE or --weights
identify --as-designed --port text.txt -o x.json --weights --loads columns.csv -> give either --loads FILE or --weights
identify --as-designed --port text.txt -o x.json --weights -> a recording needs --loads FILE
identify --as-designed --port text.txt -o x.json --loads place.csv --noise 2 -> --noise 2 must be above 0 and below 1
board --board arduino -> --board arduino must be one of auto, atmega328p, atmega2560, python
board --rate 0 -> --rate 0 must be a whole number from 1 to 65535
board --bits 99 -> bits=99 must be a whole number from 8 to 16
board --pressure 1000 -> must be from 0, at rest, to 10; the paper uses 1 to 5
board --board python -q --design small.toml --link small.toml -> exists and is no link
board --period 0 -> --period 0 must be from 0.1 to 600 s
board --sense-ohm 0 -> --sense-ohm 0 must be a whole number from 1
board --switch-ohm -1 -> switch_ohm=-1 must be from 0
board --noise 7 -> noise=7 must be from 0 to 0.1
board --serial -1 -> serial=-1 must be a whole number from 0
board --scene sphere.toml -> kind='sphere' is unknown
board --scene sphere.toml --pressure 3 -> a scene has its own design and loads
board --seconds 0 -> --seconds 0 must be above 0 s
board --truth x.txt -> --truth x.txt must be a file that ends in .nc
"""
CASES = [line.split(" -> ") for line in REFUSED.strip().splitlines()]


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A folder with files of every kind, most of them bad."""
    house = House(tmp_path_factory.mktemp("refusals"))
    folder = house.folder
    (folder / "dir").mkdir()
    (folder / "dir.zarr").mkdir()
    (folder / "dir.zarr/notes.txt").write_text("mine")
    (folder / "file.zarr").write_text("no folder")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    a_dataset(folder / "data.nc")
    a_dataset(folder / "few.nc", samples=3)
    a_dataset(folder / "nan.nc", samples=8)
    with netCDF4.Dataset(folder / "nan.nc", "a") as opened:
        opened["resistance_ohm"][7, 0, 1, 0] = np.nan
    a_dataset(folder / "wide.nc", pitch_mm=17)
    whole = (folder / "data.nc").read_bytes()
    (folder / "cut.nc").write_bytes(whole[: len(whole) * 2 // 3])
    a_model(folder / "model.safetensors")
    return house


@pytest.mark.parametrize(("typed", "said"), CASES, ids=[typed for typed, _ in CASES])
def test_a_mistake_is_one_line_and_exit_code_2(house, typed, said, monkeypatch):
    monkeypatch.setattr("hardware.session.APPEARS_S", 0.0)
    line = house.refusal(*shlex.split(typed))
    assert line.startswith("tripillar: ")
    assert said in line
    assert not any(word in line for word in ("Errno", "Traceback", "codec", "Value error"))


def test_every_command_is_among_them():
    typed = {shlex.split(line)[0] for line, _ in CASES}
    assert {name for commands in COMMANDS.values() for name in commands} <= typed
