"""What commands ask of labelled data: which sensor and network suit them, and whether the samples can be right.

A mistake is refused in one line unless the user forces it; what only costs accuracy is said in a line.
"""

from pathlib import Path
from typing import cast

from dataset import SampleError, Samples
from decoupler.data.columns import COMPONENTS, Component, component_named, distinct
from decoupler.evaluation.plausibility import disturbance, doubt, explained
from decoupler.inverse.forward_model import MIN_EXPLAINED, ForwardModel
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import Feature, Net, NetworkConfig
from decoupler.training.suited import suited_feature
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.design_file import read_design
from tripillar.pipeline.run import respond
from tripillar.terminal.console import say
from tripillar.terminal.progress import Bars


def likely_design(data: Samples, path: Path | None) -> SensorDesign | None:
    """The design that the data state, else that of a file or the paper's if its array fits; None if it does not."""
    given = SensorDesign() if path is None else read_design(path)  # read in any case: a wrong file is refused
    design = data.design or given
    return design if data.force_n.shape[1:3] == (design.array.rows, design.array.cols) else None


def known_response(design: SensorDesign | None, bars: Bars) -> ArrayResponse | None:
    """Response of a design, solved if it is not in the cache; None without a design."""
    return None if design is None else respond(design, bars)[1]


def suited_network(
    data: Samples, design: SensorDesign | None, component: str, hidden: int, net: Net, feature: str, bars: Bars
) -> tuple[NetworkConfig, ArrayResponse | None, str]:
    """The network for data, the response if its feature needs one, and a note on an unexpected choice.

    `feature` is one of `Feature`, or ``auto``: `inverse` if the response explains the data, else `root`.
    """
    automatic, note = feature == "auto", ""
    solved = known_response(design, bars) if feature == "inverse" or (automatic and net == "skip") else None
    if automatic:
        feature = suited_feature(data, component_named(component), net, solved)
        if feature == "root" and solved is not None:
            note = "the response of the design does not explain these data: inputs are √R"
        if feature == "inverse" and data.design is None:
            note = "the data state no design, but the response of --design explains them and is used"
    return NetworkConfig(hidden=hidden, net=net, feature=cast("Feature", feature)), solved, note


def judging_response(
    data: Samples,
    path: Path | None,
    design: SensorDesign | None,
    network: NetworkConfig,
    solved: ArrayResponse | None,
    bars: Bars,
) -> ArrayResponse | None:
    """The response to check data against: that of the design that they or a file state, or one that explains them."""
    if data.design is not None or path is not None:
        return known_response(design, bars) if solved is None else solved
    return solved if network.feature == "inverse" else None


def joint_model(response: ArrayResponse | None) -> ForwardModel | None:
    """The model from all forces to all pillars, which samples are checked against; None without a response."""
    return None if response is None else ForwardModel.of(response, COMPONENTS["all"])


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


def mention(file: Path, data: Samples, component: Component, forward: ForwardModel | None) -> None:
    """Say which forces the component leaves out although they act, and how many samples are given twice."""
    left_out = disturbance(data, component, forward)
    if left_out is not None:
        say(f"{file}: {left_out}")
    repeated = len(data.force_n) - len(distinct(data, component).force_n)
    if repeated:
        say(f"{file}: {repeated} of {len(data.force_n)} samples repeat an earlier one and count once")


def mention_another_sensor(file: Path, data: Samples, component: Component, forward: ForwardModel | None) -> None:
    """Say that pairs seem to come from another sensor than the model's, if its response explains too few of them."""
    share = None if forward is None else explained(data, component, forward)
    if share is not None and share < MIN_EXPLAINED:
        say(
            f"{file}: the model's response explains {max(share, 0.0):.0%} of these readings, of its own sensor's "
            f"{MIN_EXPLAINED:.0%} and more: are they of another?"
        )


def warn_of_test(model: Path, decoupler: Decoupler, file: Path, data: Samples, response: ArrayResponse | None) -> None:
    """Say why errors on these samples may mislead: training samples, a forced model, doubtful data."""
    story, component = decoupler.made_from, decoupler.component
    tuned_on = data[: story.get("pairs", 0)].content_hash
    if data.content_hash == story.get("data_hash") or tuned_on == story.get("fine_tuned_on"):
        say(f"warning: {file}: {model} was trained on these samples: its errors on others are larger")
    if "forced" in story:
        say(f"warning: {model} was written with --force: {story['forced']}")
    judge = joint_model(response)
    own = decoupler.inverse.forward if judge is None and decoupler.inverse is not None else judge
    doubted = doubt(data, component, own)
    if doubted is not None:
        say(f"warning: {file}: {doubted}")
    mention(file, data, component, judge)
