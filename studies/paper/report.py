"""The report from what was computed: sections in the order of the paper, and what all of it was made of."""

from dataclasses import dataclass

from fem.array.response import ArrayResponse
from geometry.storage.files import digest
from studies.paper.deformation import Deformation
from studies.paper.document import Report
from studies.paper.results import Results
from studies.paper.sections import decoupling, deformation, material, spacing
from studies.paper.spacing import Spacing
from studies.surroundings import surroundings

PACKAGES = ("tripillar", "numpy", "scipy", "scikit-fem", "torch", "pyvista", "matplotlib")


@dataclass(frozen=True, kw_only=True)
class Computed:
    """All that the report is about."""

    response: ArrayResponse
    deformation: Deformation
    spacing: Spacing
    results: Results


def report_of(computed: Computed) -> Report:
    """Sections, verdicts and provenance."""
    design = computed.response.design
    return Report(
        title="The paper's figures and tables on our data",
        lead=[
            "Song, Wang and Zhang, *Micromachines* 2018, 9(5), 236, [doi 10.3390/mi9050236]"
            "(https://doi.org/10.3390/mi9050236), simulate a 6 × 6 array of three-axis tactile units and decouple its "
            "forces by a small network. Here are its figures 6 to 11, its tables 1 and 2 and its claim on spacing from "
            "data of our own, its numbers beside ours: what reproduces, what is better, and what cannot be reproduced.",
            "*Paper* is what the paper prints, for data that it does not publish. *Plain, LM* is its network on our "
            "data: resistances in, no skip, Levenberg-Marquardt to a mean squared error of 1e-5. *Skip* and *skip + "
            "response* are ours: √R past the hidden layer, and the inverse of the known array response as input. "
            "*Contact* loads are a few broad indenters, *independent* ones a load of its own on every pad. Errors "
            "are eq. 17; a number after a network's name is that of hidden nodes. Written by `make paper`.",
        ],
        sections=[
            material.section(design),
            deformation.electrodes(computed.deformation, design),
            deformation.pressures(computed.deformation, design),
            spacing.section(computed.spacing, design),
            *decoupling.sections(computed.results),
        ],
        provenance=provenance(computed),
    )


def provenance(computed: Computed) -> list[list[str]]:
    """What the report was made of, by name."""
    response, spaced, results = computed.response, computed.spacing, computed.results
    return [
        ["design", f"`{digest(response.design)}`"],
        [
            "response",
            f"`{response.content_hash}`, method {response.method}, estimated error {response.error_estimate:.1e}, "
            f"solved in {sum(response.seconds.values()):.1f} s",
        ],
        ["data sets", ", ".join(dict.fromkeys(f"`{one.content_hash}`" for one in results.data_sets))],
        ["trainings", timing(results)],
        ["spacing", f"{len(spaced.spaced)} arrays, touches at {len(spaced.touches)} pitches in {spaced.seconds:.0f} s"],
        ["made on", ", ".join(f"{name} {value}" for name, value in surroundings(PACKAGES).items())],
    ]


def timing(results: Results) -> str:
    """How long the trainings took, in a line."""
    return (
        f"{results.own_trainings} of the paper's own (its network, contact loads) in {results.own_seconds:.0f} s, all "
        f"{results.all_trainings} in {results.all_seconds:.0f} s, on {results.cores} cores, samples and start of the "
        "processes included"
    )
