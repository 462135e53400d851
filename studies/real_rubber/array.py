"""``python -m studies rubber-array``: what remembering rubber costs a 6 × 6 array, and what following it leaves.

All loads of a test are pressed in 2 s, held for a minute and let go, by pillars whose numbers are spread by 15 %, where
size decides the direction. Lengths are those of the simulator, so that errors are the memory's alone.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

import tripillar as tp
from dataset.memory import PillarMemory, broken_contacts, log_rise
from decoupler.rubber.belief import SensorFilter
from decoupler.rubber.fit import identified
from decoupler.rubber.law import NAMES, Elastic, Rubber, memory_of
from decoupler.rubber.rubber_file import read_rubber, write_rubber
from decoupler.rubber.series import Series
from decoupler.rubber.unknown import next_test
from geometry.design import Memory
from geometry.layout import FloatArray
from studies.pictures.rubber import bench
from studies.tables import OUT, Folder, Row, report

#: strips as they were measured in tension (docs/rubber.md); what g₂ would be in compression nobody knows
RUBBERS = {
    "7.5 %": Memory(a=(0.575, 0.204), b_lengthen=2.47, b_shorten=9.52, tau_s=(2.2, 165.0), g1=1.88),
    "7.5 %, multisine": Memory(a=(0.67, 0.01), b_lengthen=1.1, b_shorten=8.0, tau_s=(2.6, 108.0), g1=2.9),
    "7.5 %, second fit": Memory(a=(0.257, 0.187), b_lengthen=1.39, b_shorten=11.5, tau_s=(11.8, 238.0), g1=2.25),
    "10 %": Memory(a=(0.235, 0.24), b_lengthen=1.35, b_shorten=9.84, tau_s=(17.1, 429.0), g1=1.09),
}
NONE = "none that remembers"
OWN, G2 = "7.5 %", NAMES.index("g2")
CORNERS_S, SECONDS, APART_S = (5.0, 7.0, 67.0, 69.0), 130.0, 0.1  #: rest, pressed, held, let go
MARKS_S = {"1 s held": 8.0, "60 s held": 66.9, "10 s let go": 79.0, "60 s let go": 129.0}
SPREAD, NOISE = 0.15, 0.001
SLOW, WHITE, STRETCH = 0.01, 0.2, 0.2  #: errors of the bench's ln R, what is white of them, and how far it stretches
STARTS_S = (6.0, 10.0, 40.0, 68.0, 75.0)  #: at which a board starts anew
SCANS, RUNS = 1500, 5  #: whose cost is measured, at 50 Hz


class Pressed:
    """Loads of a test on an array, held by its pillars' strains over time."""

    def __init__(self, loads: int, samples: int) -> None:
        response = tp.response(tp.SensorDesign())
        train: Any = tp.dataset(response, "three-axis", samples, seed=1, noise=NOISE, bits=12)
        test: Any = tp.dataset(response, "three-axis", loads, seed=5)
        self.model: Any = tp.train(train)
        self.rest_ohm: Any = self.model.rest_resistances()
        self.force_n = float(np.sqrt(np.mean(test.force_n[..., 2] ** 2)))
        self.time_s = np.arange(0.0, SECONDS, APART_S)
        share = np.interp(self.time_s, CORNERS_S, (0.0, 1.0, 1.0, 0.0))
        most = np.sqrt(test.resistance_ohm / self.rest_ohm).reshape(loads, -1) - 1
        self.strain = share[:, None, None] * most  #: (time, loads, pillars)

    def log_ratio(self, memory: Memory) -> FloatArray:
        """ln R/R₀ (time, loads, pillars) as pillars of a rubber show it, with the noise of single readings."""
        generator, (count, n) = np.random.default_rng(1), self.strain.shape[1:]
        factors = np.exp(SPREAD * generator.standard_normal((6, count, n)))
        spread = PillarMemory.spread(replace(memory, direction="loading"), factors)
        broken = broken_contacts(self.strain, APART_S, spread)
        clean = 2 * np.log1p(self.strain) + np.asarray(log_rise(self.strain, broken, spread))
        return np.asarray(clean + NOISE * generator.standard_normal(clean.shape))

    def errors(self, strain: FloatArray) -> dict[str, float]:
        """Root mean square errors of Fz [N] at the marks, of strains (time, loads, pillars)."""
        found = {}
        for name, mark_s in MARKS_S.items():
            at = round(mark_s / APART_S)
            forces = [
                self.model.forces(self.rest_ohm * (1 + each[at].reshape(-1, *self.rest_ohm.shape)) ** 2)[..., 2]
                for each in (strain, self.strain)
            ]
            found[f"{name} [N]"] = float(np.sqrt(np.mean((forces[0] - forces[1]) ** 2)))
        return found

    def row(self, ours: SensorFilter, log_ratio: FloatArray) -> dict[str, float]:
        """Errors by a filter, and how often deviations of 95 % hold: always, and within 1 s and a minute of a start."""
        found = [followed(ours, self.time_s, log_ratio[:, k]) for k in range(log_ratio.shape[1])]
        strain, deviation = (np.stack(each, axis=1) for each in zip(*found, strict=True))
        held = np.abs(strain - self.strain) < 1.96 * deviation
        row = self.errors(strain) | {"held [%]": 100 * float(held.mean())}
        early = []
        for start_s in STARTS_S:
            seen = slice(round(start_s / APART_S), round((start_s + 60.0) / APART_S))
            anew, wide = followed(ours, self.time_s[seen], log_ratio[seen, 0])
            early.append(np.abs(anew - self.strain[seen, 0]) < 1.96 * wide)
        first = [each[: round(1.0 / APART_S)].mean() for each in early]
        return row | {
            "1 s after a start": 100 * float(np.mean(first)),
            "a minute": 100 * float(np.concatenate(early).mean()),
        }


def followed(ours: SensorFilter, time_s: FloatArray, log_ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Strains and their standard deviations, both (time, n), of readings ln R/R₀ (time, n) in their order."""
    follower, steps = ours.start(log_ratio.shape[1]), np.diff(time_s, prepend=time_s[:1])
    found = [follower.step(*each) for each in zip(log_ratio, steps.tolist(), strict=True)]
    return np.stack([strain for strain, _ in found]), np.stack([deviation for _, deviation in found])


def static_strain(log_ratio: FloatArray, memory: Memory) -> FloatArray:
    """Strains (...) of ln R/R₀ (...) by the law with no contact broken."""
    strain = np.zeros_like(log_ratio)
    for _ in range(20):
        slope = np.maximum(2 / (1 + strain) + memory.g1 + 2 * memory.g2 * strain, 0.5)
        missing = log_ratio - 2 * np.log1p(strain) - memory.g1 * strain - memory.g2 * strain**2
        strain = np.clip(strain + missing / slope, -0.6, 0.7)
    return strain


def bench_series(memory: Memory, seed: int = 0) -> Series:
    """A bench series of a strip in the test that is proposed, with errors that stay alike for 20 s."""
    corners, levels = next_test()
    programme, elastic = (corners, STRETCH / np.max(levels) * levels), Elastic(model="neo-hookean", stiffness_n=5.0)
    return bench(seed, SLOW, memory, elastic, programme=programme, white=WHITE)


def rubber_of(memory: Memory, seed: int = 0) -> Rubber:
    """A rubber as one bench series shows it, through its file."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "rubber.toml")
        write_rubber(identified(bench_series(memory, seed)), path)
        found = read_rubber(path)
    return found


def frame_ms(ours: SensorFilter, log_ratio: FloatArray) -> float:
    """Processor time of a scan of readings (time, n) that come at 50 Hz; the least of several runs."""
    took_ms = []
    for _ in range(RUNS):
        follower, begin = ours.start(log_ratio.shape[1]), process_time()
        for each in log_ratio[:SCANS]:
            follower.step(each, 0.02)
        took_ms.append(1e3 * (process_time() - begin) / SCANS)
    return min(took_ms)


def rubber_array(
    out: Folder = OUT,
    loads: Annotated[int, Parameter(help="Number of loads, none of them trained on.")] = 8,
    samples: Annotated[int, Parameter(help="Number of samples that the decoder is trained on.")] = 2000,
    series: Annotated[int, Parameter(help="Number of bench series of the same rubber.")] = 3,
) -> None:
    """Judge what follows a rubber's memory on an array: direction known or not, wrong rubbers, starts, cost."""
    pressed, rubbers = Pressed(loads, samples), {name: rubber_of(memory) for name, memory in RUBBERS.items()}
    own, others = rubbers[OWN], [name for name in RUBBERS if name != OWN]
    files = {f"series {n}": rubber_of(RUBBERS[OWN], n) if n else own for n in range(series)}
    by = partial(_filters, pressed)
    y = np.repeat(pressed.log_ratio(RUBBERS[OWN])[40:640, 0], 5, axis=0)  # the press and half its hold
    tables: dict[str, list[Row]] = {
        f"Fz where {pressed.force_n:.0f} N rms are pressed": [
            row for name, rubber in files.items() for row in by(OWN, rubber, name)
        ],
        "another rubber's file": [row for name in (*others, NONE) for row in by(name, own, OWN)]
        + [row for name in others for row in by(OWN, rubbers[name], name)],
        "cost": [
            {"direction": way, "ms a scan of 108 pillars": frame_ms(SensorFilter.of_rubber(_stated(own, way)), y)}
            for way in ("loading", "unknown")
        ],
    }
    report(tables, out / "rubber-array.json")


def _stated(rubber: Rubber, direction: str) -> Rubber:
    """A rubber whose direction is stated, and what its series says of the others where g₂ is 0."""
    numbers, covariance = rubber.numbers, rubber.covariance
    given = numbers - covariance[:, G2] * numbers[G2] / covariance[G2, G2]
    return replace(rubber, memory=replace(memory_of(given), direction=direction))


def _filters(pressed: Pressed, truth: str, rubber: Rubber, file: str) -> list[Row]:
    """Rows of an array of one rubber, read with the file of this one or of another."""
    y = pressed.log_ratio(RUBBERS.get(truth, Memory()))
    found = {
        "no contacts": pressed.errors(static_strain(y, _stated(rubber, "loading").memory)),
        "no rubber": pressed.errors(np.expm1(0.5 * y)),
    }
    for direction in ("loading", "unknown"):
        found[f"followed, {direction}"] = pressed.row(SensorFilter.of_rubber(_stated(rubber, direction)), y)
    return [{"rubber": truth, "file of": file, "by": way} | errors for way, errors in found.items()]
