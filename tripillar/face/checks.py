"""Checks of samples: a mistake is refused unless it is forced; what only costs accuracy is said in a line."""

from dataset import SampleError, Samples
from dataset.samples import AnySamples
from decoupler.data.columns import COMPONENTS, Columns, Component
from decoupler.data.enough import drawn
from decoupler.data.pairs import Pairs
from decoupler.evaluation.plausibility import MIN_EXPLAINED, disturbance, doubt, explained, suspicion
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.decoupler import Decoupler
from fem.array.response import ArrayResponse
from tripillar.face.caller import current

#: share of its pairs that a sensor's own response explains, gains and noise aside: of one that is off by manufacture
#: 0.998 and more, with pads of the other kind 0.92 to 0.95
OWN_EXPLAINED = 0.97


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


def mention(data: Samples, name: str, component: Component, forward: SensorModel | None) -> None:
    """Say what of the forces looks wrong though it may not be, which the component leaves out, and repeated samples."""
    for said in (suspicion(data, component, forward), disturbance(data, component, forward)):
        if said is not None:
            current().say(f"{name}: {said}")
    repeated = len(data.force_n) - len(Columns.of(data, component).distinct())
    if repeated:
        current().say(f"{name}: {repeated} of {len(data.force_n)} samples repeat an earlier one and count once")


def mention_another_sensor(data: Samples, name: str, component: Component, forward: SensorModel | None) -> None:
    """Say that pairs seem to come from another sensor than the design's, if its response explains too few of them."""
    share = None if forward is None else explained(data, component, forward)
    if share is not None and share < OWN_EXPLAINED:
        current().say(
            f"{name}: the design's response explains {max(share, 0.0):.0%} of these readings, of its own "
            f"sensor's {OWN_EXPLAINED:.0%} and more: are they of another?"
        )


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
    own = decoupler.inverse.forward if judge is None and decoupler.inverse is not None else judge
    few = drawn(data)
    doubted = doubt(few, component, own)
    if doubted is not None:
        current().say(f"warning: {name}: {doubted}")
    mention(few, name, component, judge)
    share = None if own is None or doubted is not None else explained(few, component, own)
    if share is not None and share < MIN_EXPLAINED:
        current().say(
            f"warning: {name}: loads on pads explain {max(share, 0.0):.0%} of these readings, so errors of {model} are "
            "large; contacts want a decoder of 'tripillar train --touch'"
        )
