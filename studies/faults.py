"""Faults of pillars and wires that are named from 40 scans, and false alarms: ``python -m studies.faults``."""

from collections import Counter
from collections.abc import Callable

import numpy as np

from dataset import DatasetSettings, measured, simulate
from decoupler import Decoupler, train
from decoupler.evaluation.faults import WINDOW, FaultTest
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import SensorDesign
from geometry.layout import FloatArray

NOISE, BITS = 1e-3, 12
TRAINING = 2000  #: samples
NAMES = SensorDesign().unit.layout.pillar_names
WINDOWS = 40  #: of each fault, each with loads of its own and the fault in a place of its own
SOUND = 500  #: windows of the usual loads without fault, 20,000 scans
OTHERS = 100  #: the same of each other kind of loads
HELD = 10  #: scans of one load, where loads are held
PASSING = 5.0  #: stated deviations, which the error of a force must pass for its fault to count as one that matters
Broken = tuple[FloatArray, str]  #: readings (n, P) and what is to be named
Break = Callable[[FaultTest, FloatArray, np.random.Generator], Broken]


def pillar(kind: str, name: str) -> Break:
    """A pillar of this name that is stuck, open, or has another gain."""

    def broken(test: FaultTest, ohms: FloatArray, generator: np.random.Generator) -> Broken:
        unit, number = int(generator.integers(test.decoder.rows * test.decoder.cols)), NAMES.index(name)
        spoilt(kind, ohms, [len(NAMES) * unit + number], generator)
        said = "" if kind == "gain" else kind
        return ohms, said and f"pillar {name} of row {unit // test.decoder.cols}, col {unit % test.decoder.cols} {said}"

    return broken


def wire(kind: str, side: str) -> Break:
    """A wire of a row or column whose pillars are stuck or open."""

    def broken(test: FaultTest, ohms: FloatArray, generator: np.random.Generator) -> Broken:
        wires = [(name, which) for name, which in test.wires if name.startswith(side)]
        name, which = wires[generator.integers(len(wires))]
        spoilt(kind, ohms, which.tolist(), generator)
        return ohms, f"{name} {kind}"

    return broken


def spoilt(kind: str, ohms: FloatArray, which: list[int], generator: np.random.Generator) -> None:
    """Let some pillars of readings (n, P) read wrong, in place."""
    if kind == "stuck":
        ohms[:, which] = ohms[0, which]
    elif kind == "open":
        ohms[:, which] = np.inf
    else:
        ohms[:, which] *= 1.02


def swap(side: str) -> Break:
    """Two wires that are swapped, or all of two rows or columns."""

    def broken(test: FaultTest, ohms: FloatArray, generator: np.random.Generator) -> Broken:
        swaps = [(name, order) for name, order in test.swaps if name.startswith(side)]
        name, order = swaps[generator.integers(len(swaps))]
        return ohms[:, order], f"{name} swapped"

    return broken


FAULTS: dict[str, Break] = {
    **{f"one {name} pillar stuck": pillar("stuck", name) for name in NAMES},
    "one row wire stuck": wire("stuck", "row"),
    "one column wire stuck": wire("stuck", "column"),
    "two rows swapped": swap("rows"),
    "two columns swapped": swap("columns"),
    "two row wires of a kind swapped": swap("row wires"),
    "two column wires of a kind swapped": swap("column wires"),
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
    step = np.arange(WINDOW).reshape(-1, 1, 1, 1) / HELD
    whole, part = step.astype(int), step % 1.0
    size = int(whole.max()) + 2
    paths = [ohms[k : k + size] for k in range(0, len(ohms) - size, size)]
    between = [path[whole.reshape(-1)] * (1.0 - part) + path[whole.reshape(-1) + 1] * part for path in paths]
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


def main() -> None:
    """Print what docs/decoder.md says of faults."""
    response = array_response(SensorDesign())[0]
    light = exact(response, "light", OTHERS * WINDOW, 12)
    for protocol in ("three-axis", "contact"):
        asked = DatasetSettings(protocol=protocol, samples=TRAINING, seed=1, noise=NOISE, bits=BITS)
        model = train(simulate(response, asked).labels(), response=response)
        test, rest = FaultTest.of(model), model.rest_resistances()
        assert test is not None
        assert rest is not None
        generator, usual = np.random.default_rng(5), exact(response, protocol, SOUND * WINDOW, 11)
        for name, broken in FAULTS.items():
            for held in (1, HELD):
                met: Counter[str] = Counter()
                for ohms in windows(usual, WINDOWS, held, generator):
                    flat, expected = broken(test, ohms.reshape(WINDOW, -1).copy(), generator)
                    read = flat.reshape(ohms.shape)
                    named, matters = [str(fault) for fault in test.named(read)], passes(model, ohms, read)
                    met["right"] += expected in named
                    met["wrong"] += any(one != expected for one in named)
                    met["passing"] += matters
                    met["passing and right"] += matters and expected in named
                counts = f"right {met['right']}, wrong {met['wrong']} of {WINDOWS}"
                counts += f"; {PASSING:g} deviations passed by {met['passing']}, right {met['passing and right']}"
                print(f"{protocol}, {name}, each load for {held}: {counts}", flush=True)
        sound = {
            "usual loads": windows(usual, SOUND, 1, generator),
            f"usual loads, each for {HELD}": windows(usual, OTHERS, HELD, generator),
            "one usual load": windows(usual, OTHERS, WINDOW, generator),
            f"usual loads, from one to the next in {HELD}": moving(usual[: 5 * OTHERS + 1], generator),
            "light loads": windows(light, OTHERS, 1, generator),
            "rest": windows(rest[None], OTHERS, WINDOW, generator),
        }
        for name, some in sound.items():
            alarms = [found for ohms in some if (found := test.named(ohms))]
            shown = "; ".join(str(one[0]) for one in alarms[:3])
            print(
                f"{protocol}, no fault, {name}: {len(alarms)} alarms in {len(some) * WINDOW} scans {shown}", flush=True
            )


if __name__ == "__main__":
    main()
