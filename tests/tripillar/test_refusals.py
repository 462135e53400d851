"""Bad input to every command, in this process: exit code 2, one line that says what was given, nothing written.

Each line of `REFUSED` is a command as it is typed and, after ``->``, words of the line that it must end in.
"""

import shlex

import pytest

from tests.fem.scenes import BLOCK, PILLAR
from tests.house import SMALL, House
from tests.tripillar.made_files import a_dataset, a_model

FILES = {
    "broken.toml": "[array\n",
    "unknown.toml": "[array]\nrowz = 3\n",
    "sphere.toml": "[body]\nkind = 'sphere'\n",
    "idle.toml": "[body]\nkind = 'block'\nsize_mm = [9, 9, 9]\n[material]\nyoung_mpa = 1\npoisson = 0.3\n",
    "pillar.toml": PILLAR,
    "block.toml": BLOCK,
    "vary.toml": "[vary]\nkey = 'array.pitch_mm'\n",
    "small.toml": SMALL,
    "stiff.toml": SMALL + "[pad]\nkind = 'stiff'\n",
    "square.toml": SMALL.replace("rows = 1", "rows = 3").replace("cols = 2", "cols = 3"),
    "semi.csv": "fz_n_0_0;r_0_0\n1,5;2\n",
    "empty": "",
    "empty.nc": "",
    "text.txt": "hello\n",
    "text.nc": "hello\n",
    "text.json": "hello\n",
    "text.safetensors": "hello\n",
    "columns.csv": "a,b\n1,2\n",
    "place.csv": "load,row,col,fx_n,fy_n,fz_n\none,5,0,0,0,1\n",
}

REFUSED = """
designs -> Unknown command 'designs'. Did you mean 'design'?
--nonsense -> Unknown command '--nonsense'
design extra -> unexpected extra argument: extra. See 'tripillar design --help'
design --out -> --out needs a value
design --out dir -> dir is a folder: give the name of a file in it
design --out small.toml/under/a/file.toml -> small.toml
design --rows 0 -> --rows 0 must be from 1 to 255
cad --out cad --design unknown.toml -> unknown key 'rowz' in [array]; known are rows, cols, pitch_mm
cad --out cad --design broken.toml -> broken.toml: not valid TOML
cad --out cad --design data.nc -> data.nc: not a text file
solve small.toml -> the table [body] is missing
solve idle.toml --json --vtu never.vtu -> add a [[probe]]
solve pillar.toml --tolerance 0 -> --tolerance 0.0 must be a number above 0
response --out r.nc --design small.toml --tolerance 0 -> --tolerance 0 must be above 0 and below 1
press --depth 0.5 --design small.toml --shape sphere -> needs --radius
press --depth 0.5 --design small.toml --shape sphere --radius 5 --at 99,0 -> misses the sensor
press --shape cube --depth 1 -> --shape cube: must be sphere, cylinder, flat, or a file
press --shape sphere --radius 5 --depth 1 --length 3 -> --length is not of --shape sphere, which takes --radius
press --shape flat --depth 1 --size 1,2,3 -> --size 1,2,3: must be two numbers, such as 7.5,-3
dataset --protocol contact --samples 99999999999999999999999 -o x.nc -> must be from 1 to 1e+09
dataset --protocol contact --samples 5 -o data.nc --design data.nc -> data.nc is read by this command
dataset --protocol contact --samples 5 -o x.txt -> --out x.txt must be a file that ends in .nc or .zarr
dataset --protocol contact --samples 5 -o x.nc --offset=-3 -> --offset -3.0 must be
dataset --protocol contact --samples 5 -o x.nc --dtype float32 -> --dtype float32 belongs to zarr directories
dataset --protocol contact --samples 5 -o x.zarr --only force,ohm -> no variable 'ohm'; there are traction, force,
dataset --protocol contact --samples 5 -o x.zarr --only length -> holds force and resistance at least: name them, too
dataset --protocol contact --samples 5 -o x.nc --workers 2 -> belong to --strain finite and to directories
dataset --protocol contact --samples 5 -o x.zarr --workers 2 --scheduler tcp://localhost:1 -> give one of them
dataset --protocol contact --samples 1000000000 -o x.nc -> end the file's name in .zarr, or keep less of them by --only
dataset --protocol contact --samples 5 -o x.nc --dead-pillar 0,6,z -> an array of 6 × 6 units has no pillar 0,6,z
dataset --protocol contact --samples 5 -o x.nc --dead-pillar 9,9,q -> --dead-pillar 9,9,q names no pillar
dataset --protocol contact --samples 5 -o x.nc --dead-row 12 -> its row wires are 0 to 11
dataset --protocol contact --samples 5 -o x.nc --switch-ohm 70 -> belong to --crossbar: give it, too
train --touch --data data.nc -o m.safetensors -> --touch learns from presses of its own: leave --data,
train --touch --design stiff.toml -o m.safetensors -> contact by shape presses on bare rubber, these pads are stiff
train -o m.safetensors -> give --data, samples to train on; or --touch
train --data data.nc -o m.pt -> --out m.pt must be a file that ends in .safetensors
train --data cut.nc --component fz -o m.safetensors -> cut.nc: truncated or not NetCDF
train --data model.safetensors -o model.safetensors -> model.safetensors is read by this command: give another name
train --data data.nc --component fz -o m.safetensors --hidden 0 -> --hidden 0 must be from 1 on
train --data semi.csv -o m.safetensors -> its columns are separated by semicolons
identify --data semi.csv -o m.safetensors -> separate them by commas, decimals by points
evaluate --data data.nc -> give --model, or --folds to cross-validate: one of them
evaluate --model model.safetensors --data wide.nc -> array.pitch_mm: model 15, data 17
evaluate --model model.safetensors --data data.nc --component fz -> a model has its own: leave --component out
evaluate --folds 10 --data few.nc --component all -> 3 samples are too few to cross-validate: at least 4 are needed
identify --data data.nc -> give --out for the model, or --next for the loads to measure
identify --data data.nc --port p -o x.safetensors -> give --data or --port, not both
identify -o x.safetensors -> give --data or --port; --next alone says where to begin
identify --data data.nc --loads columns.csv -o x.safetensors -> --loads and --keep go with --port alone
identify --data data.nc -o x.safetensors --pairs 5 -> --pairs 5 must be at most 4: there are no more
identify --data data.nc --next -1 -> --next -1 must be from 0 to 100
identify --data data.nc -o x.safetensors --have pad:5kg -> --have goes with --next alone
identify --data data.nc --design square.toml -o x.safetensors -> data.nc is of 1 × 2 units, the design of 3 × 3
identify --as-designed --port text.txt -o x.json -> a recording needs --loads with the columns from_s and to_s
identify --as-designed --port text.txt -o x.json --loads place.csv --noise 2 -> --noise 2 must be above 0 and below 1
identify --as-designed --data data.nc -o x.json -> a data set has no circuit
export data.nc --model model.safetensors -o m.h -> give a data set, a recording or --model FILE, one of them
export data.nc -> --out is missing
export text.txt -o y.nc -> text.txt: no valid frame in 6 bytes
export text.txt -o y.txt -> must be a file that ends in .nc or .mcap or .csv
view small.toml --save x.bmp -> --save x.bmp must end in .png, .html, .mp4, .vtm
view small.toml --save x.png --pressure 0 -> --pressure 0 must be above 0 and at most 100 MPa
view small.toml --save x.png --scale big -> --scale big must be true, auto, or a number
view block.toml --save x.png --pressure 3 -> has its own loads
view small.toml --host 0.0.0.0 -> add --serve, whose page these are for, or leave --host out
view small.toml --serve --save x.png -> the page of --serve has controls of its own: leave --save out
view small.toml --serve --port board -> --port needs --model
view --serve --calibration text.json -> --calibration is of a sensor
view --serve --host 192.0.2.1 -> cannot listen on 192.0.2.1
view idle.toml --design small.toml --save x.png -> both say what to show: give one of them
sweep small.toml -> unknown key 'extends'; known are design, sweep, vary, bounds
sweep vary.toml -> 'vary' must be an array of tables, each written [[vary]]
sweep small.toml --trials 3 -> --trials are of a search: add --optimize, or leave --trials out
sweep small.toml --optimize --retry -> --retry is of sweeps
info '' -> no port was named
info missing -> missing: no such port; there are
info empty -> empty: no valid frame in 0 bytes
info data.nc -> data.nc: an export for other programs
info text.txt --model model.safetensors -> are for measuring the link: add --seconds too
live text.txt --model model.safetensors --rate 20 -> a recording has the rate that it was made at: leave --rate out
live text.txt --model model.safetensors --describe -> add --json, or leave --describe out
live text.txt --model model.safetensors --calibration text.json -> text.json is no calibration
record missing -o y.nc -> --out y.nc must be a file that ends in .frames
replay text.txt --model model.safetensors -> no valid frame in 6 bytes
replay text.txt --model model.safetensors --speed 0 -> --speed 0 must be 0.001 or more; 1 is as recorded
replay text.txt --model model.safetensors --speed 1 --no-crosstalk -> --speed only shows forces
replay text.txt --model model.safetensors --ros2 -> add --out FILE.mcap, or leave --ros2 out
replay text.nc --model model.safetensors --out text.nc -> text.nc is read by this command
tare missing -o text.json -> the file exists: build on it by --calibration
tare missing -o x.json --calibration small.toml -> small.toml is no calibration
board --pressure 1000 -> must be from 0, at rest, to 10; the paper uses 1 to 5
board --board python -q --design small.toml --link small.toml -> --link small.toml exists and is no link
board --period 0 -> --period 0 must be from 0.1 to 600 s
board --seconds 0 -> --seconds 0 must be above 0 s
"""
CASES = [line.split(" -> ") for line in REFUSED.strip().splitlines()]


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A folder with files of every kind, most of them bad."""
    house = House(tmp_path_factory.mktemp("refusals"))
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


@pytest.mark.parametrize(("typed", "said"), CASES, ids=[typed for typed, _ in CASES])
def test_a_mistake_is_one_line_and_exit_code_2(house, typed, said, monkeypatch):
    monkeypatch.setattr("hardware.session.APPEARS_S", 0.0)
    line = house.refusal(*shlex.split(typed))
    assert line.startswith("tripillar: ")
    assert said in line
    assert not any(word in line for word in ("Errno", "Traceback", "codec", "Value error"))
