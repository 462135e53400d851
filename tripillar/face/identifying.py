"""Identify one sensor from measured pairs; say which loads to measure; or find its gains and offsets alone."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from common.errors import DesignError
from geometry.design import SensorDesign
from geometry.design_file import read_tolerances
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import (
    BARE_BOARD,
    WIRES,
    DesignLike,
    File,
    Flag,
    ModelLike,
    Options,
    PairsLike,
    Protocol,
    SamplesLike,
    design_of,
    job,
)  # fmt: skip
from tripillar.face.twins import MEASURING, given_pairs, identified, measured, planned, possible_loads

if TYPE_CHECKING:
    Tolerances = Mapping[str, float] | None
    Known = stages.Twin | DesignLike | None
else:
    Tolerances = None  # of the command line those of the design's file
    Known = Path

MAX_NEXT = 100  #: loads that are proposed in advance


@job(out=".safetensors", twin=".toml", keep=None)
def identify(
    data: PairsLike | None = None,
    design: DesignLike | None = None,
    *,
    out: File | None = None,
    twin: File | None = None,
    pairs: int | None = None,
    usual: Protocol | None = None,
    tolerances: Tolerances = None,
    finite: SamplesLike | ModelLike | None = None,
    force: bool = False,
    **more: Annotated[Any, MEASURING, WIRES, BARE_BOARD],
) -> "stages.Twin":
    """Identify one sensor from measured pairs: its decoder, and what is known of its design and pillars.

    One pair is enough to begin with; `plan_loads` says which tells most.

    Parameters
    ----------
    data : Samples, StoredSamples, Pairs or path, optional
        Measured pairs: a data set (.nc), or a table of loads with readings (.csv).
    design : SensorDesign or path, optional
        Design file (TOML); default: the one that a data set states; the paper's with a table.
    out : path, optional
        Model file to write (.safetensors).
    twin : path, optional
        Twin to write (.toml): the design as it was found, with deviations.
    pairs : int, optional
        Number of pairs to use, from the first on; default: all.
    usual : str, optional
        Loads that it will meet; default: a data set's own; of tables contact, or contact-fz without shear.
    tolerances : mapping, optional
        Standard deviations of parameters by their keys, 0 for what is exactly known; default: the file's, else usual.
    finite : Samples, Decoupler or path, optional
        Samples of the design at finite strain (.nc), or a model trained on such (.safetensors).
    force : bool
        Go on although the data look wrong; a model remembers why they did.
    **more
        In place of data the fields of `twins.Measuring`, of `inputs.Wires`, and baud and timeout of
        `inputs.Board`.

    Returns
    -------
    Twin
        ``decoder``, a model for this very sensor, and ``parameters``: value and standard deviation of each uncertain
        parameter of the design. `tripillar.write` writes both.

    Raises
    ------
    DesignError
        If the design is of another array, or none is given or stated: `train` on pairs of a sensor without one.
    SampleError, FileFormatError
        If the pairs look wrong or none presses the sensor.

    Examples
    --------
    A sensor that is softer than its design, whose pillars differ by 10 %:

    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> from geometry import Array
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> soft = replace(tp.response(design), influence_mm_per_n=1.1 * tp.response(design).influence_mm_per_n)
    >>> own = tp.dataset(soft, samples=120, seed=2, noise=0.001, gain_spread=0.1)
    >>> twin = tp.identify(own[:20])
    >>> young_mpa, deviation = twin.parameters["rubber.young_mpa"]
    >>> abs(young_mpa - design.pillar_material.young_mpa / 1.1) < 3 * deviation
    True
    >>> tp.evaluate(twin.decoder, own[20:], limits=False)["fz"].errors.full_scale_pct < 1
    True
    >>> folder = Path(mkdtemp())
    >>> tp.write(twin, folder / "own.toml")
    >>> sorted(path.name for path in folder.iterdir())
    ['own.safetensors', 'own.toml']
    """
    if twin is not None and out is None:
        raise DesignError("twin= names the model file that it goes with: give out= too.")
    path = None if out is None else Path(out)
    given = measured(data, design, more, None if path is None else path.with_suffix(".csv"), force)
    if pairs is not None:
        if pairs > len(given.pairs):
            raise DesignError(f"pairs={pairs} must be at most {len(given.pairs)}: there are no more.")
        given = replace(given, pairs=given.pairs[:pairs])
    found = identified(given, usual, _tolerances(design, tolerances), finite, force)
    protocol = found.decoder.made_from["protocol"]
    dead = [
        f"{found.decoder.layout.pillar_names[pillar]} row {row} col {col}"
        for row, col, pillar in np.argwhere(found.decoder.dead)
    ]
    result: dict[str, Any] = {
        "pairs": found.n_pairs,
        "usual": protocol,
        "dead": dead,
        "parameters": {name: list(value) for name, value in found.parameters.items()},
        "excess": found.posterior.excess,
    }
    lines = [f"{name}: {value:.5g} ± {deviation:.2g}" for name, (value, deviation) in found.parameters.items()]
    lines.append(f"{found.n_pairs} pairs; χ² of their readings over their number: {found.posterior.excess:.3g}")
    lines += [f"pillars that are not read or stuck count as dead: {', '.join(dead)}"] if dead else []
    held = "loads like those given" if protocol is None else f"{protocol} loads"
    lines.append(f"deviations hold for {held} alone; for others give --usual, such as three-axis")
    if path is not None:
        stages.write_model(found.decoder, path)
        result["file"] = str(path)
        if twin is not None:
            stages.write_twin(found, Path(twin), path)
            result["twin"] = str(twin)
    current().answer(lambda: result, "\n".join(lines), path)
    return found


OF_MODEL = ("twin", "pairs", "usual", "finite")  #: options of a model
IDENTIFYING = Options(identify, "data", "design", "out", "force", *OF_MODEL)


@job()
def plan_loads(
    sensor: Known = None,
    count: int = 3,
    *,
    have: str | None = None,
    usual: Protocol | None = None,
    tolerances: Tolerances = None,
) -> "tuple[stages.NextLoad, ...]":
    """Say which known loads to measure next on a sensor, or first: those that should lower its errors most.

    Parameters
    ----------
    sensor : Twin, SensorDesign or path, optional
        What `identify` gave, for the loads to measure next; or a design, for the first; default: the paper's.
    count : int
        Number of loads, in order.
    have : str, optional
        What you have for next loads: plate:20kg,pad:15kg,string:3kg,air:30kPa; or a table (CSV); default: what a
        kitchen has.
    usual : str, optional
        Loads that it will meet; default: contact, or contact-fz for sensors without shear.
    tolerances : mapping, optional
        As of `identify`.

    Returns
    -------
    tuple of NextLoad
        ``load``, its name, and the expected ``error`` of a force after it, relative to usual ones.

    Raises
    ------
    FileFormatError
        If the list of what you have makes no sense.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> first, second = tp.plan_loads(tp.SensorDesign(array=Array(rows=1, cols=2)), 2, have="pad:5kg,plate:20kg")
    >>> first.error_before > first.error > second.error
    True
    """
    if not 1 <= count <= MAX_NEXT:
        raise DesignError(f"count={count} must be from 1 to {MAX_NEXT}.")
    proposed = planned(sensor, count, have, usual, _tolerances(sensor, tolerances))
    named = {"nothing": "nothing on it"}
    lines = [f"next: {named.get(each.load, each.load)}; then {100 * each.error:.3g} %" for each in proposed]
    if proposed:
        before = 100 * proposed[0].error_before
        lines = [f"expected error of a force before: {before:.3g} % of a usual force", *lines]
    text = "\n".join(lines) or "next: every load of the list is measured"
    current().answer(lambda: {"next": [vars(one) for one in proposed]}, text)
    return proposed


@job(out=".json", keep=None)
def calibrate(
    data: PairsLike | None = None,
    design: DesignLike | None = None,
    *,
    out: File | None = None,
    noise: float | None = None,
    force: bool = False,
    **more: Annotated[Any, MEASURING, WIRES, BARE_BOARD],
) -> "stages.SensorCalibration":
    """Find gain and offset of every pillar from measured pairs, one of them under no load; the design is exact.

    Parameters
    ----------
    data : Pairs or path, optional
        Table of loads with readings (.csv).
    design : SensorDesign or path, optional
        Design file (TOML); default: the paper's.
    out : path, optional
        Calibration file to write (.json).
    noise : float, optional
        Relative noise of a resistance, as designed; default: as measured.
    force : bool
        Go on although the data look wrong.
    **more
        As of `identify`.

    Returns
    -------
    SensorCalibration
        ``gain`` and ``offset_ohm`` of shape (rows, cols, pillars) [Ω].

    Examples
    --------
    >>> import tripillar as tp
    >>> from decoupler.data.pairs import Pairs
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> own = tp.dataset(design, "contact", 20, noise=0.001, gain_spread=0.1)
    >>> found = tp.calibrate(Pairs.of(own), design)
    >>> bool(0.88 < found.gain.min() < 1 < found.gain.max() < 1.12)
    True
    """
    if noise is not None and not 0 < noise < 1:
        raise DesignError(f"noise={noise:g} must be above 0 and below 1; 0.001 is 0.1 % of a resistance.")
    given = measured(data, design, more, None, force)
    if not isinstance(pairs := given.pairs, stages.Pairs):
        raise DesignError(
            "gains and offsets are found from pairs of a board, a recording or a table: a data set has no circuit."
        )
    response = stages.respond(given.design or SensorDesign(), current().bars)[1]
    found, residual = stages.calibrated(pairs, response, given.electronics, given.serial, noise, force)
    if out is not None:
        stages.write_calibration(found, Path(out))
    gains, offsets_ohm = ([float(each.min()), float(each.max())] for each in (found.gain, found.offset_ohm))
    result = {"file": str(out), "loads": len(pairs), "noise": found.made_from["noise"], "gain": gains}
    result |= {"offset_ohm": offsets_ohm, "residual": residual}
    text = (
        f"{len(pairs)} loads: gains {gains[0]:.3f} to {gains[1]:.3f}, offsets {offsets_ohm[0]:.0f} to "
        f"{offsets_ohm[1]:.0f} Ω; what is left: {100 * residual:.2f} %"
    )
    current().answer(lambda: result, text, out)
    return found


@job(out=None, twin=None, keep=None)
def identify_as_typed(
    *,
    as_designed: bool = False,
    next_loads: Annotated[int, Flag(name=("--next",))] = 0,
    **more: Annotated[
        Any, IDENTIFYING, Options(calibrate, "noise"), Options(plan_loads, "have"), MEASURING, WIRES, BARE_BOARD
    ],
) -> None:
    """Identify one sensor from measured pairs: its decoder, and what is known of its design and pillars.

    One pair is enough to begin with. Which command suits? `tare` zeroes a sensor with nothing on it; `identify
    --as-designed` finds gains and offsets of its pillars for existing models; `identify` makes a model of this very
    sensor, which errs least.

    Parameters
    ----------
    as_designed : bool
        Take the design as exact, and find each pillar's gain and offset; one load should be none.
    next_loads : int
        Number of loads to propose to measure next.
    out : path, optional
        Model file to write (.safetensors); as designed a calibration file (.json).
    **more
        As of `identify`, `calibrate` and `plan_loads`, which do it.
    """
    have, noise, out = more.pop("have", None), more.pop("noise", None), more.get("out")
    is_empty = more.get("data") is None and more.get("port") is None
    of_pairs = next((f"{name}=" for name, each in more.items() if each and name not in ("design", "usual")), "")
    of_model = [f"{name}=" for name in OF_MODEL if more.get(name) is not None]
    of_model += ["next_loads="] if next_loads else []
    for is_wrong, said in (
        (is_empty and not next_loads, "give data= or port=; next_loads= alone says where to begin."),
        (out is None and not next_loads, "give out= for the model, or next_loads= for the loads to measure."),
        (is_empty and of_pairs, f"{of_pairs} needs pairs: give data= or port= too."),
        (have is not None and not next_loads,
         "have= goes with next_loads= alone: it says of what the loads to propose are made."),
        (not 0 <= next_loads <= MAX_NEXT, f"next_loads={next_loads} must be from 0 to {MAX_NEXT}."),
        (as_designed and of_model, f"as_designed=True makes no model: leave {' and '.join(of_model)} out."),
        (noise is not None and not as_designed, "noise= goes with as_designed=True alone: else pairs tell their own."),
    ):  # fmt: skip
        if is_wrong:
            raise DesignError(said)
    if as_designed:
        calibrate(noise=noise, **more)
        return
    data, design = more.get("data"), more.get("design")
    if next_loads:  # a list that makes no sense is refused before anything takes time
        sensor = design_of(design) if data is None else given_pairs(data, design)[1]
        possible_loads(sensor or SensorDesign(), have)
    found = None if is_empty else identify(**more)
    if next_loads:
        plan_loads(
            found or design, next_loads, have=have, usual=more.get("usual"), tolerances=_tolerances(design, None)
        )


def _tolerances(design: object, given: Mapping[str, float] | None) -> Mapping[str, float] | None:
    """The tolerances given, else those of a design file."""
    return read_tolerances(Path(design)) if given is None and isinstance(design, Path | str) else given
