"""A board on the command line: simulated, watched, recorded, tared, calibrated; and what is refused."""

import json
import re
import signal
import subprocess
import sys
from importlib.util import find_spec
from io import StringIO

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader

import tripillar as tp
from dataset import DatasetSettings, simulate
from dataset.imperfections import Imperfections
from decoupler.data.load_table import read_pairs
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign, Unit
from geometry.layout import LAYOUTS, rest_lengths
from hardware.boards.simavr_board import find_tools
from hardware.boards.simulated import suited_kind
from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import SensorCalibration, read_calibration
from hardware.recording import read_recording
from tests.hardware.boards import recording_from_resistances
from tests.house import PATIENT_S, House

pytestmark = pytest.mark.real
RESPONSE = layer_response(SensorDesign(array=Array(rows=1, cols=2)))
MODEL = ("--model", "model.safetensors")
CALIBRATE = "identify", "--as-designed", "--design", "small.toml", "--port"
BRIEFLY = "--seconds", "0.5"
NONSENSE = "\nspam\n0 0 9000\n\n"


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A small sensor and a joint net for it."""
    house = House(tmp_path_factory.mktemp("board"))
    tp.write(tp.train(tp.dataset(RESPONSE, "contact", 300, bits=12), response=RESPONSE), house.folder / MODEL[1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tripillar.pipeline.stage.array_response", lambda *_: (RESPONSE, house.folder / "none", False))
        yield house


@pytest.fixture(scope="module")
def port(house):
    """A board whose sensor is pressed every 2 s."""
    truth = house.folder / "truth.nc"
    with tp.board(RESPONSE, chip="python", bits=12, serial=7, period_s=2.0, truth=truth) as port:
        yield port


@pytest.fixture(scope="module")
def drifted():
    """A board that rests, and whose pillars are up to 10 % off."""
    with tp.board(RESPONSE, chip="python", bits=12, pressure_mpa=0.0, gain_spread=0.1) as port:
        yield port


def forces_of(done):
    """Forces of the lines that a command printed."""
    assert done.returncode == 0, done.stderr
    return np.array([json.loads(line)["force_n"] for line in done.stdout.splitlines()])


def messages(path):
    """How many messages each topic of an MCAP file has."""
    with path.open("rb") as file:
        return sorted(make_reader(file).get_summary().statistics.channel_message_counts.values())


def test_info_says_what_the_board_is_and_how_well_it_sends(house, port):
    told = house.result("info", port)
    expected = {"rows": 1, "cols": 2, "bits": 12, "scan_mode": "ZERO_POTENTIAL", "serial": 7, "sense_ohm": 4700}
    assert {name: told[name] for name in expected} == expected
    assert "serial      7" in house.tripillar("info", port).stdout
    assert isinstance(house.result("info")["ports"], list)
    told = house.result("info", port, *MODEL, "--seconds", "1")
    assert 0 < told["device_rate_hz"] < 160  # of 150: a busy board skips scans, more than it can count
    assert told["scans"] >= 3
    assert told["statistics"]["lost"] == 0
    assert 0 < told["latency_ms"]["median"] <= told["latency_ms"]["p99"] <= told["latency_ms"]["worst"]


def test_live_gives_the_forces_that_act_and_shows_every_scan_to_viewers(house, port):
    """Each scan's forces are some of the script's, but for 12 bits and the net's error; a busy board skips scans."""
    drawn = house.tripillar("live", port, *MODEL, "--seconds", "0.3")
    assert all(said in drawn.stdout for said in ("frames/s", "0 lost"))
    has_viewers = find_spec("websockets") and find_spec("rerun")
    streams = "--foxglove-at", "127.0.0.1:0", "--mcap", "shown.mcap", "--rrd", "shown.rrd"
    done = house.tripillar("live", port, *MODEL, "--json", "--seconds", "2", *(streams if has_viewers else ()))
    lines, found = [json.loads(line) for line in done.stdout.splitlines()], forces_of(done)
    with xr.open_dataset(house.folder / "truth.nc") as opened:
        acts = opened["force_n"].values
    missed_n = np.abs(found[:, None] - acts[None]).max(axis=(2, 3, 4)).min(axis=1)
    assert missed_n.max() < 0.02 * acts.max()
    assert np.array(lines[0]["deviation_n"]).shape == (1, 2, 3)
    assert (np.diff([line["sequence"] for line in lines]) > 0).all()
    assert (np.diff([line["time_s"] for line in lines]) > 0).all()
    net = np.array([line["net_force_n"] for line in lines])
    assert net == pytest.approx(found.sum(axis=(1, 2)), rel=1e-5, abs=1e-3)  # both are rounded
    if has_viewers:
        assert re.search(r"Foxglove: open ws://127\.0\.0\.1:[1-9]\d+; this machine alone\n", done.stderr)
        assert messages(house.folder / "shown.mcap") == [1, len(found)]
        assert (house.folder / "shown.rrd").stat().st_size > 1000
        assert "shown.mcap: the file exists" in house.refusal("live", port, *MODEL, "--mcap", "shown.mcap")


def test_record_replay_and_export(house, port):
    name, keep = "press.frames", ("-o", "press.frames", *MODEL, *BRIEFLY, "-q")
    told = house.result("record", port, *keep)
    recording = read_recording(house.folder / name)
    assert told["scans"] == len(recording.sequence) > 0
    assert set(recording.made_from) == {"model_recipe", "design_hash"}
    replayed = house.result("replay", name, *MODEL)
    assert replayed["frames"] == told["scans"]
    live = forces_of(house.tripillar("replay", name, *MODEL, "--speed", "10", "--json"))
    assert live == pytest.approx(np.array(replayed["force_n"]), abs=1e-2)  # printed to 1e-4; corrected scan by scan
    assert "exists" in house.refusal("record", port, *keep)
    more = house.result("record", port, *keep, "--append")
    both = read_recording(house.folder / name)
    n = len(both.sequence)
    assert n == both.statistics.ok == told["scans"] + more["scans"]
    assert both.statistics.bad_crc == both.statistics.lost == 0
    damaged = bytearray((house.folder / name).read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (house.folder / "hurt.frames").write_bytes(damaged)
    done = house.tripillar("export", "hurt.frames", "-o", "hurt.csv")
    assert (done.returncode, done.stderr.partition("damaged at byte ")[0]) == (0, "warning: hurt.frames: ")
    assert house.result("export", name, "-o", "press.nc")["frames"] == n
    assert "an export for other programs" in house.refusal("replay", "press.nc", *MODEL)
    turned = recording_from_resistances(np.full((3, 2, 1, 3), 1e4), Info(rows=2, cols=1, bits=16))
    (house.folder / "turned.frames").write_bytes(turned)
    assert "2 × 1" in house.refusal("replay", "turned.frames", *MODEL)
    if find_spec("mcap_ros2"):
        house.result("replay", name, *MODEL, "--out", "press.mcap")
        assert messages(house.folder / "press.mcap") == [1, n]


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_recording_that_is_ended_is_kept(house, port, end):
    """All scans that it told of are in the file."""
    command = house.command("record", port, "-o", f"ended-{end}.frames")
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=house.folder) as process:
        said = ""
        while not (told := re.search(r"(\d+) scans", said)):
            character = process.stderr.read(1)
            assert character, said
            said += character
        process.send_signal(end)
        process.communicate(timeout=PATIENT_S)
    assert process.returncode == (0 if end == signal.SIGINT else -signal.SIGKILL)
    assert len(read_recording(house.folder / f"ended-{end}.frames").sequence) >= int(told[1]) > 0


def test_a_tare_takes_out_a_drift_of_the_rubber_live_and_in_a_recording_at_any_pace(house, drifted):
    """Every pillar is up to 10 % off: without a tare forces are far off; with it they are not."""
    at_rest = house.result("tare", drifted, "-o", "own.json", *BRIEFLY)
    assert np.array(at_rest["rest_ohm"]).shape == (1, 2, 3)
    for flags, is_right in ([], False), (["--calibration", "own.json"], True):
        live = house.tripillar("live", drifted, *MODEL, "--json", "--seconds", "0.2", *flags)
        assert (np.abs(forces_of(live)).max() < 5) == is_right  # of a pad's 432 N; nothing acts
    house.result("record", drifted, "-o", "own.frames", "--calibration", "own.json", *BRIEFLY, "-q")
    at_once = np.array(house.result("replay", "own.frames", *MODEL)["force_n"])
    assert np.abs(at_once).max() < 5  # nothing acts, and the tare says so
    paced = forces_of(house.tripillar("replay", "own.frames", *MODEL, "--speed", "20", "--json"))
    assert paced == pytest.approx(at_once, abs=1e-2)
    house.result("replay", "own.frames", *MODEL, "--out", "own-forces.nc")
    with xr.open_dataset(house.folder / "own-forces.nc") as forces:
        assert forces["deviation_n"].shape == at_once.shape
        assert "gain" in forces.attrs["calibration"]
        assert forces.attrs["design_hash"]
        assert forces["net_force_n"].values == pytest.approx(at_once.sum(axis=(1, 2)))
        kept = json.loads(forces.attrs["sensor"])
    live = house.tripillar("live", drifted, *MODEL, "--json", "--describe", "--seconds", "0.2").stdout
    described = json.loads(live.splitlines()[0])["sensor"]
    assert described == kept
    assert [pad["position_mm"] for pad in described["pads"]] == [[-7.5, 0.0, 0.0], [7.5, 0.0, 0.0]]


def test_calibrate_finds_gains_and_offsets_in_a_recording(house):
    """Twelve known loads, each while ten frames were sent: the specimen's gains and offsets come back."""
    specimen = {"gain_spread": 0.2, "offset_ohm": 150.0, "specimen": 3}
    loads = simulate(
        tp.response(RESPONSE.design), DatasetSettings(protocol="three-axis", samples=12, seed=1, **specimen)
    )
    info = Info(rows=1, cols=2, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=100)
    stream = recording_from_resistances(np.repeat(loads.resistance_ohm, 10, axis=0), info)
    (house.folder / "known.frames").write_bytes(stream)
    table = ["load,row,col,fx_n,fy_n,fz_n,from_s,to_s"]
    for k, force_n in enumerate(loads.force_n):
        for col in range(2):
            table.append(f"{k},0,{col},{','.join(map(str, force_n[0, col]))},{0.1 * k + 0.005},{0.1 * k + 0.095}")
    (house.folder / "loads.csv").write_text("\n".join(table))
    told = house.result(*CALIBRATE, "known.frames", "--loads", "loads.csv", "-o", "gains.json", "--noise", "5e-4", "-q")
    assert told["loads"] == 12
    assert told["residual"] < 0.005
    found = read_calibration(house.folder / "gains.json")
    gain, offset_ohm = Imperfections(**specimen).gain_and_offset(1, 2)
    rest_ohm = np.array([1e4, 1.414e4, 1.414e4])
    assert found.gain * rest_ohm + found.offset_ohm == pytest.approx(gain * rest_ohm + offset_ohm, rel=0.01)


def test_typed_weights_calibrate_and_nonsense_is_asked_again(house, drifted, monkeypatch):
    """Nothing lies on the simulated sensor, whatever is typed: refused unless forced; pairs are kept as measured."""
    done = []
    for typed, flags in ("", []), (NONSENSE, ["--keep", "pairs.csv"]), (NONSENSE, ["--force"]):
        monkeypatch.setattr(sys, "stdin", StringIO(typed))
        words = *CALIBRATE, drifted, "-o", "typed.json", "--seconds", "0.3", "--json", "-q", *flags
        done.append(house.tripillar(*words))
        assert (house.folder / "typed.json").exists() == ("--force" in flags)
    nobody, refused, forced = done
    assert nobody.returncode == refused.returncode == 2
    assert nobody.stderr.splitlines()[-1].startswith("tripillar: the input ended before the last load")
    assert "load '0 0 9000' changed the resistances by 0 % of what it should" in refused.stderr.splitlines()[-1]
    assert (forced.returncode, "'spam' is no weight" in forced.stderr) == (0, True)
    assert json.loads(forced.stdout)["loads"] == 2
    kept = read_pairs(house.folder / "pairs.csv", SensorDesign(array=Array(rows=1, cols=2)))
    assert kept.names == ("nothing", "0 0 9000")
    assert kept.force_n[1, 0, 0, 2] == pytest.approx(9 * 9.80665)


def test_a_board_of_another_layout_is_named_and_its_recording_is_none_of_the_models(house):
    """Six pillars a unit, a model of the paper's: one line, whether it is played, replayed or recorded for."""
    layout = LAYOUTS["six-pillar"]
    info = Info(rows=1, cols=2, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, layout=layout)
    ohms = np.tile(1e3 * rest_lengths(Unit(layout=layout)), (20, 1, 2, 1))
    (house.folder / "six.bin").write_bytes(recording_from_resistances(ohms, info))
    assert house.result("info", "six.bin")["layout"] == "six-pillar"
    for words in (
        ("replay", "six.bin", *MODEL),
        ("live", "six.bin", *MODEL),
        ("record", "six.bin", "--out", "six.frames", *MODEL),
    ):
        said = house.refusal(*words, "-q")
        assert "the board has layout six-pillar, the model layout song2018: take a model trained for" in said
    assert not (house.folder / "six.frames").exists()
    house.result("tare", "six.bin", "-o", "six.json", "--force")
    calibration = read_calibration(house.folder / "six.json")
    assert (calibration.layout, calibration.rest_ohm.shape) == (layout, (1, 2, 6))
    assert calibration.rest_ohm == pytest.approx(ohms[0], rel=1e-3)


def test_a_tare_of_a_sensor_that_moves_is_refused_unless_forced(house, port):
    """The script presses and slides once in the 2 s that are read; the calibration to be tared stays as it was."""
    (house.folder / "kept.json").write_text(SensorCalibration.as_designed(1, 2).to_json())
    before = (house.folder / "kept.json").read_bytes()
    tared = ("tare", port, "--calibration", "kept.json", "-o", "kept.json", "--seconds", "2")
    said = house.refusal(*tared)
    assert ("the sensor moves: pillar " in said, "--force" in said) == (True, True)
    assert (house.folder / "kept.json").read_bytes() == before
    house.result(*tared, "--force")
    assert read_calibration(house.folder / "kept.json").rest_ohm is not None


@pytest.mark.skipif(find_tools() is not None, reason=str(find_tools()))
def test_the_firmware_is_simulated_where_it_can_be(house):
    """Else frames are Python's; a chip that is asked for says why it cannot; a signal ends a board, with its code."""
    command = house.command("board", "--design", "small.toml", "-q", "--json")
    with subprocess.Popen(
        command, cwd=house.folder, env=house.environment, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert house.result("info", json.loads(process.stdout.readline())["port"])["firmware"] == "1.1.0"
        finally:
            process.send_signal(signal.SIGTERM)
    assert process.returncode == 128 + signal.SIGTERM
    kind, why = suited_kind(Info(rows=1, cols=2, bits=10, rate_hz=3000))
    assert (kind, "the firmware does not build: " in why) == ("python", True)
    done = house.tripillar("board", "--design", "small.toml", "-q", "--board", "atmega328p", "--rate", "3000")
    assert (done.returncode, "RATE: 1 to what the scan time allows" in done.stderr) == (2, True)


def test_a_broken_pillar_is_named_in_the_first_scan_and_left_out(house):
    """A board with an open pillar: what it carries is foretold by the others, and who watches is told which it is."""
    with tp.board(RESPONSE, chip="python", bits=12, pressure_mpa=0.0, dead_pillars=("0,1,x",)) as broken:
        first = json.loads(
            house.tripillar(
                "live", broken, "--model", "model.safetensors", "--seconds", "1", "--json"
            ).stdout.splitlines()[0]
        )
    assert first["left_out"] == [[0, 1, "x"]]
    assert not first["unreliable"]
    assert np.abs(first["force_n"]).max() < 40.0  # at rest; read as a reading it would be thousands
