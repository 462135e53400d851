"""The benchmark as a table for people."""

from rich.table import Table

from studies.bench.work_precision import Measurement, fastest_below

ERRORS = (5e-2, 1e-2, 3e-3, 1e-3)  #: at which families are compared


def work_precision_table(scene: str, measurements: list[Measurement]) -> Table:
    """Every contender at every resolution."""
    table = Table(title=f"{scene}: run time against error")
    table.add_column("contender")
    for header in ("resolution", "loaded probe", "worst probe", "seconds", "unknowns", "peak MiB"):
        table.add_column(header, justify="right")
    last = None
    for one in measurements:
        name = one.contender if one.contender != last else ""
        last = one.contender
        if one.failure:
            table.add_row(name, f"{one.resolution:g}", one.failure, "", "", "", "")
            continue
        table.add_row(
            name,
            f"{one.resolution:g}",
            f"{one.first_error:.2%}",
            f"{one.worst_error:.2%}",
            f"{one.seconds:.2f}",
            f"{one.unknowns:,}",
            f"{one.peak_mib:,.0f}",
        )
    return table


def ratio_table(scene: str, measurements: list[Measurement], loaded: bool = False, ours: str = "TriPillar") -> Table:
    """Seconds of the fastest of each family at equal error, and how many times the default path's."""
    families = list(dict.fromkeys(one.family for one in measurements))
    table = Table(title=f"{scene}: fastest at or below an error of the {'loaded' if loaded else 'worst'} probe")
    table.add_column("family")
    for error in ERRORS:
        table.add_column(f"{error:.1%}", justify="right")
    best = {error: fastest_below(measurements, error, loaded) for error in ERRORS}
    for family in families:
        cells = []
        for error in ERRORS:
            found, own = best[error].get(family), best[error].get(ours)
            if found is None:
                cells.append("–")
            elif own is None or family == ours:
                cells.append(f"{found.seconds:.2f} s")
            else:
                cells.append(f"{found.seconds:.2f} s, {found.seconds / own.seconds:.1f}×")
        table.add_row(family, *cells)
    return table
