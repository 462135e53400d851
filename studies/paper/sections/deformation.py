"""Figures 6, 7 and 8: the electrodes before and after, and the array under 1, 3 and 5 MPa."""

from itertools import pairwise

from geometry.design import SensorDesign
from studies.paper.deformation import CAP, LOADED, Deformation, middle_unit
from studies.paper.document import Grid, Picture, Section, Verdict
from studies.paper.sections.words import listed, strain, whole_percent
from tripillar.pipeline.printed import LARGEST_FORCE_N, PRESSURES_MPA

FIGURE_6, FIGURE_7, FIGURE_8 = "figure-6.png", "figure-7.png", "figure-8.png"


def electrodes(found: Deformation, design: SensorDesign) -> Section:
    """Figures 6 and 8."""
    one, array = found.sample, design.array
    return Section(
        anchor="figures-6-and-8",
        title="Figures 6 and 8: the electrodes before and after",
        verdict=Verdict(
            reproduces=(
                f"The {array.rows} × {array.cols} grid of electrodes “2” of figure 6, and that loads move it as in "
                f"figure 8: in the state shown an upper electrode moves by {one.largest_mm:.1f} mm at most, by "
                f"{one.sideways_mm:.1f} mm along the surface."
            ),
            better=(
                "Electrodes are drawn where finite elements put them, to an estimated "
                f"{100 * found.error_estimate:.1g} % of what a pad does to its own unit; the state is a sample of "
                "the kind that joint networks are trained on."
            ),
            cannot=(
                "The paper prints neither pitch nor load nor displacement of the two pictures, so there is no number "
                "of its to set beside ours."
            ),
        ),
        blocks=[
            Picture(
                file=FIGURE_6,
                shows="The grid of upper electrodes at rest",
                caption="**Figure 6.** The upper electrode “2” of every unit at rest.",
            ),
            Picture(
                file=FIGURE_8,
                shows="The same electrodes under a load, joined to where they were",
                caption=(
                    "**Figure 8.** The same electrodes under one sample of the protocol `contact`, which presses and "
                    f"drags at once: up to {one.force_n['fz']:.0f} N on a pad along z, {one.force_n['fx']:.0f} N along "
                    f"x and {one.force_n['fy']:.0f} N along y; no pillar is strained beyond "
                    f"{strain(one.largest_strain)}."
                ),
            ),
        ],
    )


def pressures(found: Deformation, design: SensorDesign) -> Section:
    """Figure 7."""
    alone = [one for one in found.pressed if one.loaded == "one pad"]
    grows = all(a.largest_mm < b.largest_mm for a, b in pairwise(alone))
    around = all(one.largest_at == middle_unit(design) for one in alone)
    largest, light = alone[-1], found.light
    return Section(
        anchor="figure-7",
        title="Figure 7: the deformation under 1, 3 and 5 MPa",
        verdict=Verdict(
            reproduces=(
                f"Larger pressure {'gives' if grows else 'does not always give'} larger deformation, "
                f"{'most' if around else 'though not most'} at the pressed unit: "
                f"{listed(f'{one.largest_mm:.2f}' for one in alone)} mm at "
                f"{listed(f'{p:g}' for p in PRESSURES_MPA)} MPa on one pad."
            ),
            better=(
                f"Every pillar's strain is known: at {largest.pressure_mpa:g} MPa on one pad its pillars z, x and y "
                f"change by {listed(strain(s) for s in largest.strain.values())}; some pillar reaches "
                f"{whole_percent(CAP)} at {found.cap_mpa['one pad']:.1f} MPa on one pad, at "
                f"{found.cap_mpa['all pads']:.1f} MPa on all."
            ),
            cannot=(
                f"The paper prints no displacement, and its loads do not fit one another: the {LARGEST_FORCE_N:g} N it "
                f"states as the largest force strain no pillar of this array by more than "
                f"{strain(light.largest_strain)}, far from its {whole_percent(CAP)}."
            ),
        ),
        blocks=[
            Picture(
                file=FIGURE_7,
                shows="The deformed array under 1, 3 and 5 MPa on one pad, side by side",
                caption=(
                    "**Figure 7.** Nine units on a slab of their own, so that one can be seen, under "
                    f"{listed(f'{p:g}' for p in PRESSURES_MPA)} MPa on the pad in the middle; true scale, colour by "
                    "size of the displacement. The numbers below are of the whole array."
                ),
            ),
            _table(found),
            (
                f"**Of the paper's loads.** {LARGEST_FORCE_N:g} N on a pad are {light.pressure_mpa:.2f} MPa, not 1 "
                "to 5. A pillar that bore them alone, as eq. 6 has it, would be strained by "
                f"{strain(found.alone_strain)}, and by {whole_percent(CAP)} under {found.alone_n:.1f} N: its forces "
                "and strains fit eq. 6, where no matrix shares the load, rather than its finite elements. Ours fit "
                "the finite elements: 1 to 5 MPa on each pad."
            ),
            (
                "**How far to trust these.** Lengths are exact in the displacements, but these are linear in the "
                f"load: at {largest.pressure_mpa:g} MPa, "
                f"{whole_percent(largest.pressure_mpa / design.matrix_material.young_mpa)} of Young's modulus, "
                "rubber itself is no longer linear, which neither the paper nor we compute."
            ),
        ],
    )


def _table(found: Deformation) -> Grid:
    return Grid(
        title="Under pressure (the paper prints pictures, no numbers)",
        header=[
            "loaded",
            "pressure [MPa]",
            "force on a pad [N]",
            "largest displacement [mm]",
            "middle unit: strain of z",
            "x",
            "y",
            "of any pillar",
        ],
        rows=[
            [
                one.loaded,
                f"{one.pressure_mpa:g}",
                f"{one.force_n:.0f}",
                f"{one.largest_mm:.2f}",
                *(strain(value) for value in one.strain.values()),
                strain(one.largest_strain),
            ]
            for loaded in LOADED
            for one in found.pressed
            if one.loaded == loaded
        ],
    )
