"""What commands do about samples that look wrong: say so in a line, and write nothing unless told to."""

from pathlib import Path

from dataset import LabelledData
from decoupler.data.components import COMPONENTS, Component
from decoupler.data.errors import SampleError
from decoupler.data.selection import distinct, selected
from decoupler.evaluation.plausibility import disturbance, doubt, explained
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.model_inverse import MIN_EXPLAINED
from decoupler.model.decoupler import Decoupler
from fem.array.response import ArrayResponse
from tripillar.terminal.console import say


def heed(file: Path, doubted: str | None, force: bool) -> dict[str, str]:
    """Refuse a file that is doubted; with `force` warn, and return what the model is to remember of it.

    Raises
    ------
    SampleError
        If it is doubted and not forced.
    """
    if doubted is None:
        return {}
    if not force:
        raise SampleError(f"{file}: {doubted}. Nothing was done; --force goes on all the same.")
    say(f"warning: {file}: {doubted}")
    return {"forced": doubted}


def joint_model(response: ArrayResponse | None) -> ForwardModel | None:
    """What samples are judged by: all pillars under all forces."""
    return None if response is None else ForwardModel.of(response, COMPONENTS["all"])


def mention(file: Path, data: LabelledData, component: Component, forward: ForwardModel | None) -> None:
    """Say what is no mistake but costs something: forces that the component leaves out, samples given twice."""
    left_out = disturbance(data, component, forward)
    if left_out is not None:
        say(f"{file}: {left_out}")
    repeated = len(data.force_n) - len(distinct(data, component).force_n)
    if repeated:
        say(f"{file}: {repeated} of {len(data.force_n)} samples repeat an earlier one and count once")


def mention_another_sensor(file: Path, data: LabelledData, component: Component, forward: ForwardModel | None) -> None:
    """Say that pairs seem to be of another sensor than the model's, where it explains too little of them."""
    share = None if forward is None else explained(data, component, forward)
    if share is not None and share < MIN_EXPLAINED:
        say(
            f"{file}: the model's response explains {max(share, 0.0):.0%} of these readings, of its own sensor's "
            f"{MIN_EXPLAINED:.0%} and more: are they of another?"
        )


def warn_of_test(
    model: Path, decoupler: Decoupler, file: Path, data: LabelledData, response: ArrayResponse | None
) -> None:
    """Say what makes errors on these samples mean less than they seem to."""
    story, component = decoupler.made_from, decoupler.component
    tuned_on = selected(data, slice(story.get("pairs", 0))).content_hash
    if data.content_hash == story.get("data_hash") or tuned_on == story.get("fine_tuned_on"):
        say(f"warning: {file}: {model} was trained on these samples: its errors on others are larger")
    if "forced" in story:
        say(f"warning: {model} was written with --force: {story['forced']}")
    forward = joint_model(response)
    if forward is None and decoupler.inverse is not None:
        forward = decoupler.inverse.forward
    doubted = doubt(data, component, forward)
    if doubted is not None:
        say(f"warning: {file}: {doubted}")
    mention(file, data, component, joint_model(response))
