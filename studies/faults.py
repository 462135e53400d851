"""``python -m studies faults``: faults of pillars and wires that are named from 40 scans, and false alarms."""

from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dataset import DatasetSettings, measured, simulate
from decoupler import Decoupler, train
from decoupler.evaluation.faults import WINDOW, FaultTest
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from studies.tables import OUT, Folder, Row, report

NOISE, BITS = 1e-3, 12
NAMES = SensorDesign().unit.layout.pillar_names
HELD = 10  #: scans of one load, where loads are held
PASSING = 5.0  #: stated deviations, which the error of a force must pass for its fault to count as one that matters
#: a fault somewhere in readings (n, P), which it changes, and what is to be named
Break = Callable[[FaultTest, FloatArray, np.random.Generator], str]


def spoil(kind: str, ohms: FloatArray, which: list[int]) -> None:
    """Make pillars stuck, open, or read 2 % too much."""
    wrong: dict[str, Any] = {"stuck": ohms[0, which], "open": np.inf, "gain": 1.02 * ohms[:, which]}
    ohms[:, which] = wrong[kind]


def pillar(kind: str, name: str) -> Break:
    """A pillar of this name that is stuck, open, or has another gain."""

    def broken(test: FaultTest, ohms: FloatArray, generator: np.random.Generator) -> str:
        unit, cols = int(generator.integers(test.decoder.rows * test.decoder.cols)), test.decoder.cols
        spoil(kind, ohms, [len(NAMES) * unit + NAMES.index(name)])
        return "" if kind == "gain" else f"pillar {name} of row {unit // cols}, col {unit % cols} {kind}"

    return broken


def wire(kind: str, side: str) -> Break:
    """A wire of a row or column whose pillars are stuck or open."""

    def broken(test: FaultTest, ohms: FloatArray, generator: np.random.Generator) -> str:
        wires = [(name, which) for name, which in test.wires if name.startswith(side)]
        name, which = wires[generator.integers(len(wires))]
        spoil(kind, ohms, which.tolist())
        return f"{name} {kind}"

    return broken


def swap(side: str) -> Break:
    """Two wires that are swapped, or all of two rows or columns."""

    def broken(test: FaultTest, ohms: FloatArray, generator: np.random.Generator) -> str:
        swaps = [(name, order) for name, order in test.swaps if name.startswith(side)]
        name, order = swaps[generator.integers(len(swaps))]
        ohms[:] = ohms[:, order]
        return f"{name} swapped"

    return broken


FAULTS: dict[str, Break] = {
    **{f"one {name} pillar stuck": pillar("stuck", name) for name in NAMES},
    **{f"one {side} wire stuck": wire("stuck", side) for side in ("row", "column")},
    "two rows swapped": swap("rows"),
    "two columns swapped": swap("columns"),
    **{f"two {side} of a kind swapped": swap(side) for side in ("row wires", "column wires")},
    "one z pillar open": pillar("open", "z"),
    "one row wire open": wire("open", "row"),
    "one z pillar 2 % up": pillar("gain", "z"),
}


def windows(ohms: FloatArray, n: int, held: int, generator: np.random.Generator) -> list[FloatArray]:
    """n windows of readings (`WINDOW`, rows, cols, 3) of resistances (m, rows, cols, 3), each held for some scans."""
    each = WINDOW // held
    numbers = np.arange(n * each) % len(ohms)
    loads = [ohms[numbers[k * each : (k + 1) * each]] for k in range(n)]
    return [measured(np.repeat(load, held, axis=0), NOISE, BITS, generator) for load in loads]


def moving(ohms: FloatArray, generator: np.random.Generator) -> list[FloatArray]:
    """Windows of readings that go evenly from one of some resistances (m, rows, cols, 3) to the next."""
    step = np.arange(WINDOW) / HELD
    whole, part = step.astype(int), (step % 1.0)[:, None, None, None]
    size = int(whole.max()) + 2
    paths = [ohms[k : k + size] for k in range(0, len(ohms) - size, size)]
    between = [path[whole] * (1.0 - part) + path[whole + 1] * part for path in paths]
    return [measured(one, NOISE, BITS, generator) for one in between]


def exact(response: ArrayResponse, protocol: str, n: int, seed: int) -> FloatArray:
    """Resistances of a protocol's loads without errors, (n, rows, cols, 3) [Ω]."""
    return simulate(response, DatasetSettings(protocol=protocol, samples=n, seed=seed)).labels().resistance_ohm


def passes(model: Decoupler, sound: FloatArray, broken: FloatArray) -> bool:
    """Check whether a fault errs a force by `PASSING` half-widths of 68 % in some scan of a window, or is refused.

    Readings (`WINDOW`, rows, cols, 3) without the fault and with it; looked at are the pads whose pillars read wrong.
    """
    if not np.isfinite(broken).all():
        return True
    errs = np.abs(model.forces(broken) - model.forces(sound)) > PASSING * model.half_widths(broken)[0]
    return bool(errs[:, (broken != sound).any(axis=(0, 3))].any())


def named_of(
    model: Decoupler, test: FaultTest, broken: Break, sound: list[FloatArray], generator: np.random.Generator
) -> Row:
    """In how many windows a fault is named rightly, or something else is, and the same of those where it matters."""
    met: Counter[str] = Counter()
    for ohms in sound:
        read = ohms.copy()
        expected = broken(test, read.reshape(WINDOW, -1), generator)
        named, matters = [str(fault) for fault in test.named(read)], passes(model, ohms, read)
        met["right"] += expected in named
        met["wrong"] += any(one != expected for one in named)
        met[f"past {PASSING:g} deviations"] += matters
        met["of these right"] += matters and expected in named
    return dict(met)


def faults(
    out: Folder = OUT,
    samples: Annotated[int, Parameter(help="Training samples.")] = 2000,
    times: Annotated[int, Parameter(help="Windows of each fault, each with its own loads and place.")] = 40,
    sound: Annotated[int, Parameter(help="Windows of usual loads without a fault; a fifth of other loads.")] = 500,
) -> None:
    """Count faults that are named, and false alarms."""
    named, alarms, others = list[Row](), list[Row](), max(sound // 5, 1)
    response = array_response(SensorDesign())[0]
    light = exact(response, "light", others * WINDOW, 12)
    for protocol in ("three-axis", "contact"):
        asked = DatasetSettings(protocol=protocol, samples=samples, seed=1, noise=NOISE, bits=BITS)
        model = train(simulate(response, asked).labels(), response=response)
        test, rest = FaultTest.of(model), model.rest_resistances()
        assert test is not None
        assert rest is not None
        generator, usual = np.random.default_rng(5), exact(response, protocol, sound * WINDOW, 11)
        for name, broken in FAULTS.items():
            for held in (1, HELD):
                found = named_of(model, test, broken, windows(usual, times, held, generator), generator)
                named.append({"loads": protocol, "fault": name, "each load for": held, "windows": times} | found)
        without = {
            "usual loads": windows(usual, sound, 1, generator),
            f"usual loads, each for {HELD}": windows(usual, others, HELD, generator),
            "one usual load": windows(usual, others, WINDOW, generator),
            f"usual loads, from one to the next in {HELD}": moving(usual[: 5 * others + 1], generator),
            "light loads": windows(light, others, 1, generator),
            "rest": windows(rest[None], others, WINDOW, generator),
        }
        for name, some in without.items():
            met = [str(told[0]) for ohms in some if (told := test.named(ohms))]
            said = {"scans": len(some) * WINDOW, "alarms": len(met), "such as": met[0] if met else ""}
            alarms.append({"trained on": protocol, "without a fault": name} | said)
    report({"Faults that are named": named, "False alarms": alarms}, out / "faults.json")
