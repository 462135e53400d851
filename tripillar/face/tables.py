"""Tables of results that the commands print."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from geometry.layout import AXES
from tripillar.face import stages

MIN_SHOWN = 0.01  #: of the largest force on a unit: those below are left out of a contact's table
NO_SHARE = "–: some of these forces are near 0, where relative errors (eq. 17) mean nothing"
ERRORS = ("relative error", "RMSE [N]", "% of full scale")


def _headed(left: tuple[str, ...], right: tuple[str, ...], **settings: Any) -> Table:
    """An empty table with columns of text and columns of numbers."""
    table = Table(**settings)
    for header in (*left, *right):
        # escaped, else rich takes [mm] for a style
        table.add_column(escape(header), justify="right" if header in right else "left")
    return table


def _cells(errors: "stages.ForceErrors") -> tuple[str, str, str]:
    relative = "–" if errors.rel_err is None else f"{errors.rel_err:.2%}"
    return relative, f"{errors.rmse_n:.3f}", "–" if errors.full_scale_pct is None else f"{errors.full_scale_pct:.3f}"


def comparison_table(comparisons: "list[stages.Comparison]") -> Table:
    """Errors of every decoupler on every protocol's test samples, beside the paper's."""
    (training, _), (test, _) = stages.SPLITS["train"], stages.SPLITS["test"]
    cap, as_read, pairs = stages.CAP, stages.AS_READ, stages.PAIRS
    table = _headed(
        ("data", "decoupler"),
        ("rel. error", "RMSE [N]", "% of full scale", as_read, "at rest [N]", "as made", "identified"),
        title=f"Decoupling errors on {test} test samples ({training} for training, strain ≤ {cap:.0%}), noise-free",
        caption="Test samples come from the response that ours starts from; full scale is the largest force on a pad.\n"
        f"{as_read}: relative error of the same networks on the same samples, read with that noise and converter.\n"
        "At rest: nothing is on the sensor. As made: relative error on a sensor whose geometry, rubber, gains and\n"
        f"offsets are a little off, with that noise and converter; identified: from {pairs} measured pairs of it",
    )
    for comparison in comparisons:
        title = f"{comparison.protocol}\nto {comparison.full_scale_n:.0f} N a pad"
        table.add_row(title, "paper's figure (its own data)", f"{comparison.paper_rel_err:.2%}")
        for entry in comparison.entries:
            at_rest = "" if entry.at_rest_n is None else f"{entry.at_rest_n:.3f}"
            read, *made = [
                f"{errors.rel_err:.2%}" if errors and errors.rel_err else ""
                for errors in (entry.as_read, entry.as_made, entry.identified)
            ]
            table.add_row("", entry.decoupler, *_cells(entry.errors), read, at_rest, *made)
        floor = f"PCA floor of {comparison.floor_hidden} nodes"
        table.add_row("", floor, *_cells(comparison.plain_floor), style="dim", end_section=True)
    return table


def stage_table(ran: "list[stages.Stage]") -> Table:
    """Time of every stage, and what was reused."""
    table = _headed(("stage",), ("seconds",), title="Stages")
    table.add_column("")
    for stage in ran:
        table.add_row(stage.name, f"{stage.seconds:.1f}", "reused, nothing changed" if stage.reused else stage.note)
    table.add_row("all", f"{sum(stage.seconds for stage in ran):.1f}", "")
    return table


def assessment_table(assessed: "Mapping[str, stages.Assessment]") -> Table:
    """Errors of one model on one dataset, beside the limit of the readings and the simplest decouplers."""
    shares = [
        f"{name} {one.coverage[0]:.1%} and {one.coverage[1]:.1%}" for name, one in assessed.items() if one.coverage
    ]
    caption = f"errors within the 68 % and 95 % deviation: {', '.join(shares)}" if shares else ""
    if any(one.errors.rel_err is None for one in assessed.values()):
        caption += f"\n{NO_SHARE}"
    table = _headed(("force", "decoupler"), (*ERRORS, "times the limit"), caption=caption)
    for name, one in assessed.items():
        table.add_row(
            name,
            "this model" if one.coverage else "predictions",
            *_cells(one.errors),
            "–" if one.ratio is None else f"{one.ratio:.3f}",
        )
        if one.limits is not None:
            unbiased = one.limits.cramer_rao_n
            shown = "not determined" if unbiased is None else f"{unbiased:.3f}"
            table.add_row("", "limit without bias (Cramér-Rao)", "", shown, "", "", style="dim")
            table.add_row("", "limit knowing the usual loads", "", f"{one.limits.bayes_n:.3f}", "", "", style="dim")
        for label, errors in one.baselines.items():
            table.add_row("", label, *_cells(errors), "")
        table.add_section()
    return table


def assessed_touch_tables(found: "stages.TouchAssessment") -> list[Table]:
    """Errors of a touch decoder: of units by force, then of the net force, its place and the units that are loaded."""
    table = _headed(("of all contacts",), ("value",))
    table.add_row("median error of the net Fz", f"{found.net_fz_median_pct:.1f}%")
    table.add_row(escape("median error of the centre of pressure [mm]"), f"{found.centre_mm:.2f}")
    one, two = found.loaded_coverage
    table.add_row(escape("RMSE of Fz on loaded units [N]"), f"{found.loaded_rmse_n:.3g}")
    table.add_row("their errors within the 68 % and 95 % deviation", f"{one:.1%} and {two:.1%}")
    return [assessment_table(found.by_force), table]


def crossval_table(tested: "list[stages.Fold]") -> Table:
    """Errors of every fold, their mean and their spread."""
    title = f"{len(tested)}-fold cross-validation"
    caption = NO_SHARE if any(each.rel_err is None for fold in tested for each in fold.errors.values()) else None
    table = _headed((), ("fold", "force", *ERRORS, "iterations", "seconds"), title=title, caption=caption)
    for number, fold in enumerate(tested, 1):
        for row, (name, errors) in enumerate(fold.errors.items()):
            trained = ("", "") if row else (str(fold.iterations), f"{fold.seconds:.1f}")
            table.add_row("" if row else str(number), name, *_cells(errors), *trained)
    table.add_section()
    for label, statistic in (("mean", np.mean), ("spread", np.std)):
        for name, errors in stages.over_folds(tested, statistic).items():
            table.add_row(label, name, *_cells(errors), "", "")
    return table


def solution_table(solution: "stages.Solution") -> Table:
    """Displacement of every probe of a scene, with how far to trust it below."""
    caption = (
        f"estimated error {solution.error_estimate:.1e}, energy {solution.energy_mj:.5g} mJ, {solution.unknowns} "
        f"unknowns, residual {solution.residual:.0e}, {sum(solution.seconds.values()):.2f} s"
    )
    table = _headed(("probe",), tuple(f"u{axis} [mm]" for axis in AXES), min_width=100, caption=caption)
    for name, displacement in solution.probes.items():
        table.add_row(escape(name), *(f"{u:.6g}" for u in displacement))
    return table


def contact_table(contact: "stages.Contact", strain: float) -> Table:
    """Results of a contact, and the forces of the units that it loads most."""
    table = _headed(("",), AXES, title="Contact; forces on the sensor, z positive in compression")
    size = np.linalg.norm(contact.force_n, axis=2)
    units = np.argwhere(size >= MIN_SHOWN * size.max()).tolist()
    vectors = [
        ("net force [N]", contact.net_force_n),
        ("moment about the array's middle [N mm]", contact.moment_nmm),
        ("centre of pressure [mm]", contact.centre_mm),
        *((f"unit {row},{col} [N]", contact.force_n[row, col]) for row, col in units),
    ]
    for name, values in vectors:
        table.add_row(escape(name), *(f"{value.round(3) + 0.0:.3f}" for value in values))
    table.add_section()
    for name, value in (
        ("contact area [mm²]", f"{contact.area_mm2:.2f}"),
        ("peak pressure [MPa]", f"{contact.peak_mpa:.3f}"),
        ("estimated error of the units' forces", f"{contact.error_estimate:.1%}"),
        ("estimated error of the electrodes' motion", f"{contact.electrode_error_estimate:.1%}"),
        ("share that sticks", f"{contact.sticking:.0%}"),
        ("largest strain of a pillar", f"{strain:.1%}"),
    ):
        table.add_row(escape(name), "", "", value)
    return table
