"""Identify one sensor from measured pairs, checked first; the command calls this, too."""

from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.design import SensorDesign
from geometry.errors import DesignError, FileFormatError, require_type

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.data.enough import AnySamples
    from decoupler.data.pairs import Pairs
    from decoupler.twin.identification import Twin
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities
    from geometry.layout import FloatArray
    from tripillar.face.checks import Caller
    from tripillar.terminal.progress import Bars


MAX_PAIRS = 1000  #: that are taken unless more are asked for: 4000 take thrice as long and identify no better


def identify(
    pairs: "AnySamples | Pairs",
    design: SensorDesign | None = None,
    *,
    usual: str | None = None,
    force: bool = False,
    caller: "Caller | None" = None,
) -> "Twin":
    """Identify one sensor from measured pairs of forces and resistances, few or many.

    Parameters
    ----------
    pairs : Samples, StoredSamples or Pairs
        Measured on the sensor; of more than 1000 samples a random draw is taken. `decoupler.data.pairs.Pairs` also say
        how well forces are known.
    design : SensorDesign, optional
        What was meant; default: the one that the samples state. Without one the pairs alone decide.
    usual : str, optional
        Protocol of loads like those that the sensor will meet; default: the pairs' own.
    force : bool
        True goes on although the pairs look wrong; the decoder remembers why they did.
    caller : Caller, optional
        As of `tripillar.train`.

    Returns
    -------
    Twin
        ``decoder``, a model for this very sensor, and ``parameters``: value and standard deviation of each uncertain
        parameter of the design. `tripillar.write` writes both.

    Raises
    ------
    DesignError
        If the design is of another array, or usual loads are named but no design is known.
    SampleError, FileFormatError
        If the pairs look wrong or none presses the sensor.

    Examples
    --------
    A sensor that is softer than its design, whose pillars differ by 10 %:

    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> soft = replace(tp.response(design), influence_mm_per_n=1.1 * tp.response(design).influence_mm_per_n)
    >>> own = tp.simulate(soft, samples=120, seed=2, noise=0.001, gain_spread=0.1)
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
    from dataset.samples import Samples
    from dataset.stored import StoredSamples
    from decoupler.data.pairs import Pairs
    from decoupler.twin.identification import identify
    from tripillar.face.checks import Caller

    caller = caller or Caller()
    if not isinstance(pairs, Samples | StoredSamples):
        require_type("pairs", pairs, Pairs, "give samples, or decoupler.data.pairs.Pairs")
    pairs = few_pairs(pairs, caller)
    sensor = design or (pairs.design if isinstance(pairs, Samples) else None)
    rows, cols = pairs.force_n.shape[1:3]
    if sensor is not None and (sensor.array.rows, sensor.array.cols) != (rows, cols):
        raise DesignError(f"{caller.samples} is of {rows} × {cols} units, the design is not: give this array's design.")
    if usual is not None and sensor is None:
        raise DesignError("usual loads are those of a design: give the design, or leave them out.")
    response, sensitivities = (None, None) if sensor is None else with_derivatives(sensor, caller.bars)
    checked, forced = checked_pairs(pairs, response, force, caller)
    loads_n = None if usual is None or sensor is None else usual_loads(sensor, usual)
    twin = identify(checked, response, sensitivities, loads_n=loads_n)
    return replace(twin, decoder=replace(twin.decoder, made_from=twin.decoder.made_from | forced))


def few_pairs(pairs: "AnySamples | Pairs", caller: "Caller", asked: int | None = None) -> "Samples | Pairs":
    """The pairs, or of more than `MAX_PAIRS` samples so many drawn at random, unless more are `asked` for; says so."""
    from decoupler.data.enough import drawn
    from decoupler.data.pairs import Pairs

    if isinstance(pairs, Pairs):
        return pairs
    most = max(asked or 0, MAX_PAIRS)
    if len(pairs) > most:
        caller.say(f"{caller.samples}: {most:,} of {len(pairs):,} pairs, drawn at random, identify the sensor")
    return drawn(pairs, 0, most)


def checked_pairs(
    pairs: "Samples | Pairs", response: "ArrayResponse | None", force: bool, caller: "Caller"
) -> "tuple[Pairs, dict[str, str]]":
    """Pairs whose stuck pillars count as not read, each once, and what a decoder must remember of doubts."""
    from decoupler.data.columns import component_named
    from decoupler.data.pairs import Pairs
    from decoupler.data.repeats import distinct
    from decoupler.evaluation.plausibility import doubt
    from decoupler.inverse.forward_model import ForwardModel
    from decoupler.inverse.sample_checks import without_stuck
    from decoupler.twin.identification import acting
    from hardware.readout.known_loads import doubt_about
    from tripillar.face.checks import heed, joint_model, mention, mention_another_sensor

    if isinstance(pairs, Pairs):
        doubted = None if response is None else doubt_about(pairs, response)
        if doubted and not force:
            raise FileFormatError(f"{doubted} Or take the pairs as they are with {caller.go_on}.")
        return pairs, {"forced": doubted} if doubted else {}
    component, judge = component_named(acting(Pairs.of(pairs))), joint_model(response)
    forced = heed(_contacts(pairs) or doubt(pairs, component, judge), force, caller)
    mention(pairs, component, judge, caller)
    mention_another_sensor(pairs, component, judge, caller)
    own = None if response is None else ForwardModel.of(response, component)
    return Pairs.of(distinct(without_stuck(pairs, component, own), component)), forced


def _contacts(pairs: "Samples") -> str | None:
    """Say in a line that samples are of contacts by shape; None if they are of loads on pads."""
    from dataset.protocols import INDENT

    if pairs.made_from.get("protocol") != INDENT:
        return None
    return f"the protocol '{INDENT}' presses shapes, and a sensor is identified from loads on its pads: measure such"


def with_derivatives(design: SensorDesign, bars: "Bars") -> "tuple[ArrayResponse, ResponseSensitivities]":
    """The response of a design and its derivatives, from the cache or solved."""
    from fem.array.sensitivities import response_sensitivities
    from tripillar.pipeline.run import respond

    _, response = respond(design, bars)
    advance = bars.begin("sensitivities", total=1)
    sensitivities, _, reused = response_sensitivities(design, None, lambda step: advance(0, step))
    advance(1, "reused" if reused else "")
    return response, sensitivities


def usual_loads(design: SensorDesign, protocol: str) -> "FloatArray":
    """Random loads of a protocol, (n, rows, cols, 3) [N]."""
    from dataset.protocols import PROTOCOLS
    from decoupler.twin.identification import LOADS
    from decoupler.twin.usual_loads import loads_of

    if protocol not in PROTOCOLS:
        raise DesignError(f"usual={protocol!r} is unknown; choose one of {', '.join(PROTOCOLS)}.")
    return loads_of(protocol, design, LOADS)
