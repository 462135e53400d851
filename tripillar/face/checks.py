"""Checks of samples: a mistake is refused unless it is forced; what only costs accuracy is said in a line."""

from common.errors import DesignError, require_type
from dataset import SampleError, Samples
from dataset.samples import AnySamples, drawn
from decoupler.data.columns import COMPONENTS, Columns, Component
from decoupler.data.pairs import Pairs
from decoupler.evaluation.plausibility import disturbance, doubt, suspicion
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from tripillar.face.caller import current
from tripillar.pipeline.stage import respond


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
