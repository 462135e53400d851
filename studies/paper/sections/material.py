"""Table 1, and what else the paper says of its sensor, beside the design that stands for it here."""

from dataset.protocols import NORMAL_MPA, TANGENTIAL_MPA
from geometry.design import SensorDesign
from geometry.layout import rest_lengths
from studies.paper.document import Grid, Section, Verdict
from studies.paper.sections.words import listed
from tripillar.pipeline.printed import TABLE_1, Rubber


def rubber_of(design: SensorDesign) -> Rubber:
    """The pillars' material with the two moduli that follow from it: K = E/(3(1 − 2ν)), G = E/(2(1 + ν))."""
    material = design.pillar_material
    lame, mu = material.lame_mpa
    return Rubber(young_mpa=material.young_mpa, poisson=material.poisson, bulk_mpa=lame + 2 * mu / 3, shear_mpa=mu)


def section(design: SensorDesign) -> Section:
    """Table 1."""
    ours, papers = rubber_of(design), TABLE_1
    given = (ours.young_mpa, ours.poisson) == (papers.young_mpa, papers.poisson)
    follow = round(ours.bulk_mpa, 2) == papers.bulk_mpa and round(ours.shear_mpa, 2) == papers.shear_mpa
    return Section(
        anchor="table-1",
        title="Table 1: the rubber, and the rest of the sensor",
        verdict=Verdict(
            reproduces=(
                f"Young's modulus and Poisson's ratio are {'those' if given else 'not those'} of the paper; the bulk "
                f"and shear moduli that follow from ours, {ours.bulk_mpa:.2f} and {ours.shear_mpa:.2f} MPa, "
                f"{'are' if follow else 'are not'} the two that it prints."
            ),
            better="Each value is a key of the design file, and what is computed states the design it is of.",
            cannot=(
                "The paper gives no modulus for the matrix, no resistivity, one pitch nor the exact loaded area, and "
                "forces that do not fit its pressures ([figure 7](#figure-7)): here these are assumptions, stated "
                "below."
            ),
        ),
        blocks=[_table(design, ours)],
    )


def _table(design: SensorDesign, ours: Rubber) -> Grid:
    unit, matrix, area = design.unit, design.matrix_material, design.pad.size_mm**2
    lengths = listed(f"{length:.2f}" for length in rest_lengths(unit))
    normal, tangential = (
        f"{low:g} to {high:g} MPa ({low * area:.0f} to {high * area:.0f} N)"
        for low, high in (NORMAL_MPA, TANGENTIAL_MPA)
    )
    rows = [
        ["Young's modulus [MPa]", f"{TABLE_1.young_mpa:g}", f"{ours.young_mpa:g}"],
        ["Poisson's ratio", f"{TABLE_1.poisson:g}", f"{ours.poisson:g}"],
        ["bulk modulus [MPa]", f"{TABLE_1.bulk_mpa:g}", f"{ours.bulk_mpa:.2f}"],
        ["shear modulus [MPa]", f"{TABLE_1.shear_mpa:g}", f"{ours.shear_mpa:.2f}"],
        ["matrix: modulus [MPa], ratio", "not given", f"{matrix.young_mpa:g}, {matrix.poisson:g}"],
        ["resistivity [Ω mm]", "not given", f"{design.resistivity_ohm_mm:g}"],
        ["units", "6 × 6", f"{design.array.rows} × {design.array.cols}"],
        ["pillars z, x, y: length [mm]", "10, 10√2 and 10√2", lengths],
        ["section of a pillar [mm²]", "4", f"{unit.pillar_width_mm**2:g}"],
        ["pitch [mm]", "10 to 20", f"{design.array.pitch_mm:g}"],
        ["loaded area [cm²]", "around 1", f"{area / 100:g}"],
        ["normal load of a unit", "0 to 10 N; 1, 3, 5 MPa", normal],
        ["tangential load of a unit", "0 to 10 N", tangential],
    ]
    return Grid(title="Table 1 and what the text gives", header=["", "paper", "here"], rows=rows)
