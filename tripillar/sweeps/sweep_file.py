"""Sweep files: TOML read into a `Sweep`, unknown keys and nonsense refused in one line that names the place."""

import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

from common.errors import DesignError
from common.quantity import positive, quantity, require_sound
from common.storage.text_file import StrictTables, read_text, tables_of
from dataset import Imperfections
from fem.array.solving import ResponseSettings
from geometry.design import SensorDesign
from geometry.design_file import design_from_dict
from geometry.layout import Layout
from geometry.layout_file import layout_from_tables
from tripillar.sweeps.rows import Metric, metrics_for
from tripillar.sweeps.variables import CHOICES, Variable

STRICT = StrictTables(DesignError)
MAX_SAMPLES = 100_000  #: rows of one sweep


@dataclass(frozen=True, kw_only=True)
class Judging:
    """The settings by which each design is judged."""

    tolerance: float = quantity(1e-2, "relative error wanted of the response")
    noise: float = quantity(1e-3, "relative standard deviation of a resistance")
    bits: int | None = None  #: of the converter; None reads exactly
    cap: float = positive(0.3, "largest strain of a pillar; the paper uses 0.2 and 0.3", within=(0, 1), below=True)
    touch_n: float = quantity(0.0, "normal force of a touch on bare rubber; 0: touches are not judged", within=(0, 1e6))

    def __post_init__(self) -> None:
        require_sound(self)
        ResponseSettings(tolerance=self.tolerance)
        Imperfections(noise=self.noise, bits=self.bits)
        if not self.noise and self.bits is None:
            raise DesignError("noise=0 and no bits leave no error to compare designs by: give noise = 0.001.")


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Limits of a metric, for designs to be acceptable."""

    least: float = -math.inf
    most: float = math.inf

    def __post_init__(self) -> None:
        for number in (self.least, self.most):
            if not isinstance(number, int | float) or math.isnan(number):
                raise DesignError(f"{number!r} must be a number.")
        if not self.least <= self.most:
            raise DesignError(f"least={self.least:g} is above most={self.most:g}.")

    def excess(self, value: float | None) -> float:
        """Distance of a value from the bounds, relative to the bound; 0 within them, infinite without a value."""
        if value is None:
            return math.inf
        over = max(self.least - value, value - self.most, 0.0)
        return over / max(abs(self.least if value < self.least else self.most), 1e-300) if over else 0.0


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sweep: its variables, their sampling, the judging of designs, and the bounds of acceptable ones."""

    base: SensorDesign
    variables: tuple[Variable, ...]
    sampling: str = quantity("sobol", "order in which designs are drawn", of=("sobol", "latin-hypercube", "grid"))
    samples: int = quantity(64, "designs, except for a grid; trials of a search", within=(1, MAX_SAMPLES))
    seed: int = quantity(0, "seed of the sampling", within=(0, 2**32), below=True)
    least: str = "error_n"  #: the metric to minimise
    judging: Judging = field(default_factory=Judging)
    bounds: dict[str, Bound] = field(default_factory=dict)  #: by metric

    def __post_init__(self) -> None:
        require_sound(self)
        if not self.variables:
            raise DesignError("nothing is varied: give at least one [[vary]] with key, low and high.")
        keys = list(chain.from_iterable(variable.key for variable in self.variables))
        twice = next((key for key in keys if keys.count(key) > 1 or key.partition(".")[0] in {*keys} - {key}), None)
        if twice is not None:
            raise DesignError(f"{twice} is varied twice: keep one of them.")
        shares = {key for variable in self.variables if variable.of for key in variable.key}
        chained = next((variable for variable in self.variables if variable.of in shares), None)
        if chained is not None:
            raise DesignError(f"{chained.name} is a share of {chained.of}, itself a share: name the key that is not.")
        for name in (self.least, *self.bounds):
            if not isinstance(name, str) or name not in self.metrics:
                raise DesignError(f"no metric {name!r}; known are {', '.join(self.metrics)}.")
            if name.startswith("touch_") and not self.judging.touch_n:
                raise DesignError(
                    f"{name} needs touch_n, the normal force of a touch: write touch_n = 20.0 in [sweep]."
                )
        if self.sampling == "grid":
            ranged = next((variable for variable in self.variables if not variable.values), None)
            if ranged is not None:
                raise DesignError(f"{ranged.name}: a grid needs values in place of a range.")
            count = math.prod(len(variable.values) for variable in self.variables)
            if count > MAX_SAMPLES:
                raise DesignError(f"the grid has {count} designs, at most {MAX_SAMPLES} are taken: use fewer values.")

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """What its rows hold, by name; of the pillars of all its layouts."""
        names = (layout.body.pillar_names for layout in self.layouts)
        return metrics_for(dict.fromkeys(chain.from_iterable(names)))

    @property
    def layouts(self) -> list[Layout]:
        """Those of its designs."""
        varied = next((variable.changes for variable in self.variables if variable.name == "layout"), None)
        return [self.base.unit.layout] if varied is None else [layout_from_tables(change) for change in varied]

    def excess(self, metrics: dict[str, float | None]) -> float:
        """Sum of how far a design's metrics are out of bounds; 0 if all are within."""
        return sum(bound.excess(metrics.get(name)) for name, bound in self.bounds.items())


def read_sweep(path: Path) -> Sweep:
    """Read a sweep file; `DesignError` if it is missing, not TOML or no sweep. The message begins with the path."""
    text = read_text(path, "give a sweep file, such as examples/sweep.toml", DesignError)
    return sweep_from_dict(tables_of(text, path, DesignError), str(path), path.parent)


def sweep_from_dict(table: dict[str, Any], source: str = "the sweep", folder: Path = Path()) -> Sweep:
    """A sweep from the nested tables of a TOML file, paths in it from a folder on; errors as in `read_sweep`."""
    found: Sweep = STRICT.made(source, _sweep, table=table, folder=folder)
    return found


def _sweep(table: dict[str, Any], folder: Path) -> Sweep:
    STRICT.require_keys(table, ("design", "sweep", "vary", "bounds"))
    settings = STRICT.table(table, "sweep")
    judged = tuple(spec.name for spec in fields(Judging))
    own = ("sampling", "samples", "seed", "least")
    STRICT.require_keys(settings, (*own, *judged), " in [sweep]")
    sweep: Sweep = STRICT.made(
        "[sweep]",
        Sweep,
        base=design_from_dict(STRICT.table(table, "design"), "[design]"),
        variables=tuple(_variable(*entry, folder) for entry in STRICT.entries(table, "vary")),
        judging=STRICT.made("[sweep]", Judging, **{key: settings[key] for key in judged if key in settings}),
        bounds={name: _bound(name, entry) for name, entry in STRICT.table(table, "bounds").items()},
        **{key: settings[key] for key in own if key in settings},
    )
    return sweep


def _variable(place: str, entry: dict[str, Any], folder: Path) -> Variable:
    known = tuple(spec.name for spec in fields(Variable) if spec.name != "changes")
    is_choice = isinstance(entry.get("key"), str) and entry["key"] in CHOICES
    STRICT.require_keys(entry, ("key", "values") if is_choice else known, f" in {place}")
    key, values = entry.get("key", []), entry.get("values", [])
    keys = [key] if isinstance(key, str) else key
    if not (isinstance(keys, list) and all(isinstance(one, str) for one in keys) and isinstance(values, list)):
        raise DesignError(f"{place}: key must be a text or a list of texts, values a list.")
    if is_choice:
        chosen: Variable = STRICT.made(place, Variable.of_texts, key=key, texts=values, folder=folder)
        return chosen
    variable: Variable = STRICT.made(place, Variable, **entry | {"key": tuple(keys), "values": tuple(values)})
    return variable


def _bound(name: str, entry: Any) -> Bound:
    if not isinstance(entry, dict):
        raise DesignError(f"[bounds]: {name} must be written {{least = 1.0}}, {{most = 2.0}} or both.")
    bound: Bound = STRICT.filled(f"[bounds] {name}", Bound, entry, ("least", "most"))
    return bound
