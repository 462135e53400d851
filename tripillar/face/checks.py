"""Checks of samples: a mistake is refused unless it is forced; what only costs accuracy is said in a line."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import bdtr

from common.errors import DesignError, require_type
from dataset import SampleError, Samples
from dataset.protocols import INDENT, PROTOCOLS
from dataset.samples import ENOUGH, FALSE_ALARMS, AnySamples, drawn
from dataset.variables import MAX_N
from decoupler.data.columns import COMPONENTS, Columns, Component
from decoupler.data.pairs import Pairs
from decoupler.evaluation.assessment import Assessment
from decoupler.evaluation.plausibility import disturbance, doubt, suspicion
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from tripillar.face.caller import current
from tripillar.pipeline.stage import respond

#: least part of errors that 95 % deviations hold of a sensor that is not quite the model: docs/results.md has 86 %
LEAST_HELD = 0.85


def joint_model(response: ArrayResponse | None) -> SensorModel | None:
    """The model from all forces to all pillars, which samples are checked against; None without a response."""
    return None if response is None else SensorModel.of(response, COMPONENTS["all"])


def heed(doubted: str | None, name: str, force: bool) -> dict[str, str]:
    """Refuse samples that are doubted; with `force` warn, and return what the model is to remember of it.

    Raises
    ------
    SampleError
        If it is doubted and not forced.
    """
    if doubted is None:
        return {}
    if not force:
        raise SampleError(f"{name}: {doubted}. Nothing was done; force=True goes on all the same.")
    current().say(f"warning: {name}: {doubted}")
    return {"forced": doubted}


def require_heeded(data: Samples, name: str, maps: bool, form: NetworkConfig) -> None:
    """Refuse what training would ignore: a form if it `maps` strain, or strain."""
    is_finite, mend = data.is_finite, ""
    if maps and is_finite.any() and form != NetworkConfig():
        mend = "is at finite strain, which maps learn: leave hidden=, net= and feature= out, or give feature='root'"
    elif not maps and is_finite.any() != is_finite.all():
        mend = "holds linear samples and others at finite strain: give one kind, or component='all' with a design"
    if mend:
        raise DesignError(f"{name} {mend}.")


def enough(samples: AnySamples, seed: int, name: str, purpose: str) -> Samples:
    """The samples, or a draw of those that are too many; says so."""
    few = drawn(samples, seed)
    if len(few) < len(samples):
        current().say(f"{name}: {len(few):,} of {len(samples):,} samples, drawn at random, {purpose}")
    return few


def mention(
    data: Samples | Pairs, name: str, component: Component, forward: SensorModel | None, is_known: bool
) -> None:
    """Say what looks wrong unless that `is_known`, which forces the component leaves out, and what is given twice."""
    if not is_known and (said := suspicion(data, component, forward)):
        current().say(f"warning: {name}: {said}")
    if isinstance(data, Pairs):
        return
    left_out = disturbance(data, component, forward)
    if left_out is not None:
        current().say(f"{name}: {left_out}")
    repeated = len(data.force_n) - len(Columns.of(data, component).distinct())
    if repeated:
        current().say(f"{name}: {repeated} of {len(data.force_n)} samples repeat an earlier one and count once")


def warn_of_test(decoupler: Decoupler, model: str, data: AnySamples, name: str, response: ArrayResponse | None) -> None:
    """Say why errors on these samples may mislead: training samples, a forced model, doubtful data."""
    story, component = decoupler.made_from, decoupler.component
    identified_on = "identified_on" in story and Pairs.of(data[: story["pairs"]]).content_hash
    if data.content_hash == story.get("data_hash") or (identified_on and identified_on == story["identified_on"]):
        told = f"{model} was trained on these samples: its errors on others are larger"
        current().say(f"warning: {name}: {told}")
    if "forced" in story:
        current().say(f"warning: {model} was made by force of doubtful samples: {story['forced']}")
    judge = joint_model(response)
    knows = judge is None or "identified_on" in story  # a model of this very sensor
    own = decoupler.inverse.forward if knows and decoupler.inverse is not None else judge
    few = drawn(data)
    forced = heed(doubt(few, component, own), name, force=True)
    mention(few, name, component, own, bool(forced) or isinstance(decoupler, DecouplerAtStrain))


def warn_of_predictions(predicted_n: FloatArray, data: AnySamples, name: str, response: ArrayResponse | None) -> None:
    """Say what looks wrong in another program's forces for samples of pads, whose readings should follow them.

    Along axes that it leaves out, NaN, forces are those of the samples.
    """
    if response is None or data.made_from.get("protocol") == INDENT:
        return
    whole = data[:]
    force_n = np.clip(np.where(np.isnan(predicted_n), whole.force_n, predicted_n), -MAX_N, MAX_N)
    heed(doubt(drawn(replace(whole, force_n=force_n)), COMPONENTS["all"], joint_model(response)), name, force=True)


def warn_of_deviations(
    decoupler: Decoupler, model: str, data: AnySamples, name: str, assessed: Mapping[str, Assessment]
) -> None:
    """Say which 95 % deviations hold far fewer errors than they say, the loads of both sides, and what to do.

    Fewer than `LEAST_HELD` by more than binomial chance, where the forces of a sample, which err together, count once.
    """
    n = min(len(data), ENOUGH)
    held = {force: one.coverage[1] for force, one in assessed.items()}
    narrow = [f"{force} {share:.0%}" for force, share in held.items() if bdtr(share * n, n, LEAST_HELD) < FALSE_ALARMS]
    if not narrow:
        return
    ours, theirs = (made_from.get("protocol") for made_from in (decoupler.made_from, data.made_from))
    why = f"{model} is made for {ours or 'other'} loads{f', these are {theirs}' if theirs else ''}"
    if ours == theirs is not None:
        why = f"{model} seems to be of another sensor or other ranges of loads"
    usual = f" --usual {theirs}" if theirs in PROTOCOLS else ""
    current().say(
        f"warning: {name}: 95 % deviations hold too few errors ({', '.join(narrow)}): {why}: 'tripillar identify"
        f"{usual}' from pairs, or train on such data"
    )


def fits(design: SensorDesign, samples: AnySamples) -> bool:
    """Samples are of an array of the design's size and layout."""
    return (*samples.shape, samples.layout) == (design.array.rows, design.array.cols, design.unit.layout)


def response_of(
    samples: AnySamples, name: str, design: SensorDesign | None, given: ArrayResponse | None
) -> ArrayResponse | None:
    """The response that is given, or that of the samples' design, solved if need be; None if it is unknown."""
    if given is None:
        if design is None or not fits(design, samples):
            return None
        return respond(design, current().bars)[1]
    require_type("response", given, ArrayResponse, "solve one with tripillar.response, or give None")
    if not fits(given.design, samples) or (design is not None and given.design != design):
        raise DesignError(
            f"the response is of another design than {name}: solve one with tripillar.response of their design, or "
            "give none."
        )
    return given
