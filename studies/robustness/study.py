"""The same loads measured by ever worse sensors: nets trained on each, and their errors."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from common.pool import in_parallel
from dataset import DatasetSettings, Imperfections, Samples, measured_again, simulate
from dataset.measurement import ReadingError
from decoupler import Assessment, Decoupler, NetworkConfig, TrainingConfig, assess, component_named
from decoupler.data.columns import Columns, force_columns
from decoupler.inverse.limits import bayes
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.settings import Feature
from fem.array.response import ArrayResponse
from geometry.layout import FloatArray

HIDDEN = 17  #: the paper's best
NETS: tuple[Feature, ...] = ("inverse", "root")  #: inputs of the two skip nets: the response's inverse, and √R
NOISES = (0.001, 0.005, 0.01)
BITS = (8, 10, 12, 16)
BAR = 1.15  #: of the limit, that the net with the response's inverse is to stay below
LIMIT_SAMPLES = 200  #: of which the limits of single units are worked out; as many as `assess` takes
SEEDS = {"train": 1, "test": 2}  #: of loads and of noise


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Numbers of simulated samples."""

    train: int = 2000
    test: int = 400


@dataclass(frozen=True, kw_only=True)
class ErrorRow:
    """One line of the table: errors of one force, in % of full scale."""

    part: str
    case: str
    net: str  #: feature of its inputs
    force: str
    error_pct: float
    limit_pct: float | None = None  #: Cramér-Rao
    bayes_pct: float | None = None  #: Bayes, which knows the usual loads
    coverage: tuple[float, float] | None = None  #: shares of errors within the 68 % and the 95 % deviation

    @property
    def ratio(self) -> float | None:
        """Error over the limit."""
        return self.error_pct / self.limit_pct if self.limit_pct else None

    @property
    def cells(self) -> dict[str, Any]:
        """Its row of a table; a ratio beyond the bar of the net that is to meet it says so."""
        is_beyond = self.part == "noise" and self.net == "inverse" and self.ratio is not None and self.ratio > BAR
        return asdict(self) | {"error / limit": self.ratio, f"above {BAR:g}": "yes" if is_beyond else ""}


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A model with its assessment on test samples."""

    model: Decoupler
    assessed: dict[str, Assessment]
    bayes_n: FloatArray  #: (rows, cols, 3): Bayes limit of every unit [N]


@dataclass(frozen=True, kw_only=True)
class LoadedSensor:
    """The loads, and the response of the sensor as designed."""

    response: ArrayResponse
    loads: dict[str, Samples]  #: by the names of `SEEDS`

    def measured(self, faults: Imperfections, split: str) -> Samples:
        return measured_again(self.loads[split], faults, SEEDS[split]).labels()


def sensor_under_load(response: ArrayResponse, sizes: Sizes) -> LoadedSensor:
    """Loads on all pads along all axes, drawn once; sensors differ in how they measure them."""
    counts = {"train": sizes.train, "test": sizes.test}
    loads = {
        split: simulate(response, DatasetSettings(protocol="three-axis", samples=n, seed=SEEDS[split]))
        for split, n in counts.items()
    }
    return LoadedSensor(response=response, loads=loads)


def dead_cases(rows: int, cols: int) -> dict[str, Imperfections]:
    """One dead pillar of each kind, one dead row wire and one dead column wire, in the middle of the array."""
    row, col, noise = rows // 2, cols // 2, NOISES[0]
    pillars = {f"dead {p} pillar": Imperfections(noise=noise, dead_pillars=((row, col, p),)) for p in "zxy"}
    return pillars | {
        "dead row wire": Imperfections(noise=noise, dead_rows=(2 * row,)),
        "dead column wire": Imperfections(noise=noise, dead_cols=(2 * col,)),
    }


def study_sensors(sensor: LoadedSensor, progress: Callable[[str], None] = lambda case: None) -> list[ErrorRow]:
    """Train every net on every sensor, and assess. `progress` is called with each trained case."""
    array = sensor.response.design.array
    noises = {f"noise {noise:.1%}": Imperfections(noise=noise) for noise in NOISES}
    converters = {f"{bits} bits": Imperfections(bits=bits) for bits in BITS}
    dead = dead_cases(array.rows, array.cols)
    models = trained(sensor, noises | converters | dead, progress)
    parts = {"noise": noises, "converter": converters}
    rows = [
        row
        for part, cases in parts.items()
        for case in cases
        for net in NETS
        for row in _rows(part, case, net, models[case, net])
    ]
    return rows + [
        row
        for case, faults in dead.items()
        for net in NETS
        for row in with_dead(sensor, case, faults, net, models[case, net])
    ]


def trained(
    sensor: LoadedSensor, cases: dict[str, Imperfections], progress: Callable[[str], None]
) -> dict[tuple[str, Feature], Trained]:
    """Both nets of every case, by case and net, in parallel processes."""
    keys = [(case, net) for case in cases for net in NETS]
    usual_n = sensor.loads["train"].force_n
    jobs = [
        (_trained, *(sensor.measured(cases[case], split) for split in ("train", "test")), net, sensor.response, usual_n)
        for case, net in keys
    ]
    found = in_parallel(jobs, lambda number: progress(keys[number][0]))
    return dict(zip(keys, found, strict=True))


def _trained(data: Samples, test: Samples, feature: Feature, response: ArrayResponse, usual_n: FloatArray) -> Trained:
    from decoupler import train  # loads torch: in the processes that train, and only there

    model = train(data, "all", NetworkConfig(hidden=HIDDEN, feature=feature), TrainingConfig(), response=response)
    return Trained(model=model, assessed=assess(model, test, response), bayes_n=unit_bayes(response, test, usual_n))


def _rows(part: str, case: str, net: Feature, found: Trained) -> list[ErrorRow]:
    rows = []
    for axis, (force, one) in enumerate(found.assessed.items()):
        assert one.errors.full_scale_pct is not None
        assert one.limits is not None
        pct_per_n = one.errors.full_scale_pct / one.errors.rmse_n
        unbiased = one.limits.cramer_rao_n
        rows.append(
            ErrorRow(
                part=part, case=case, net=net, force=force, error_pct=one.errors.full_scale_pct,
                limit_pct=None if unbiased is None else unbiased * pct_per_n,
                bayes_pct=_rms(found.bayes_n[..., axis]) * pct_per_n, coverage=one.coverage,
            )
        )  # fmt: skip
    return rows


def with_dead(sensor: LoadedSensor, case: str, faults: Imperfections, net: Feature, found: Trained) -> list[ErrorRow]:
    """Errors of the units that lost a pillar and of the others."""
    test = sensor.measured(faults, "test")
    assert test.dead is not None
    missed_n, full_scale = unit_rmse(found.model, test), np.abs(test.force_n).max(axis=(0, 1, 2))
    affected = test.dead.any(axis=2)
    return [
        ErrorRow(
            part=case,
            case=f"{label}: {int(units.sum())}",
            net=net,
            force=force,
            error_pct=100.0 * _rms(missed_n[units, axis]) / full_scale[axis],
            bayes_pct=100.0 * _rms(found.bayes_n[units, axis]) / full_scale[axis],
        )
        for label, units in (("its units", affected), ("others", ~affected))
        for axis, force in enumerate(component_named("all").forces)
    ]


def unit_rmse(model: Decoupler, data: Samples) -> FloatArray:
    """Root mean squared error of every unit, (rows, cols, 3) [N]."""
    return np.sqrt(((model.forces(data.resistance_ohm) - data.force_n) ** 2).mean(axis=0))


def unit_bayes(response: ArrayResponse, data: Samples, usual_n: FloatArray) -> FloatArray:
    """Bayes limit of every unit, which knows the usual loads (n, rows, cols, 3) [N]; shape (rows, cols, 3) [N]."""
    parts = component_named("all")
    forward = SensorModel.of(response, parts)
    own = Columns.of(data[:LIMIT_SAMPLES], parts)
    errors = ReadingError(noise=data.noise, bits=data.bits)
    least = bayes(forward, own.force_n, errors, data.shape, own.readable, force_columns(usual_n, parts))
    return np.sqrt((least**2).mean(axis=0)).reshape(data.force_n.shape[1:])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))
