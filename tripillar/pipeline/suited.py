"""Which network suits given data, and the response of which sensor it starts from."""

from pathlib import Path
from typing import cast

from dataset.samples import LabelledData
from decoupler.data.components import component_named
from decoupler.inverse.model_inverse import suited_feature
from decoupler.model.settings import Feature, Net, NetworkConfig
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.design_file import read_design
from tripillar.pipeline.run import respond
from tripillar.terminal.progress import Bars


def likely_design(data: LabelledData, path: Path | None) -> SensorDesign | None:
    """The design that the data state, else that of a file or the paper's if its array fits; None if it does not."""
    given = SensorDesign() if path is None else read_design(path)  # read in any case: a wrong file is refused
    design = data.design or given
    return design if data.force_n.shape[1:3] == (design.array.rows, design.array.cols) else None


def known_response(design: SensorDesign | None, bars: Bars) -> ArrayResponse | None:
    """Response of a design, solved if it is not in the cache; None of none."""
    return None if design is None else respond(design, bars)[1]


def judging_response(
    data: LabelledData,
    path: Path | None,
    design: SensorDesign | None,
    network: NetworkConfig,
    solved: ArrayResponse | None,
    bars: Bars,
) -> ArrayResponse | None:
    """The response that data are judged by: of the design that they or a file state, or one that explains them."""
    if solved is None and (data.design is not None or path is not None):
        return known_response(design, bars)
    return solved if data.design is not None or path is not None or network.feature == "inverse" else None


def suited_network(
    data: LabelledData, design: SensorDesign | None, component: str, hidden: int, net: Net, feature: str, bars: Bars
) -> tuple[NetworkConfig, ArrayResponse | None, str]:
    """The network for data, the response of the design where its feature needs it, and a word on an unexpected choice.

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
