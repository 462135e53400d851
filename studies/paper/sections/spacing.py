"""The paper's claim that units belong 1 to 2 cm apart."""

from itertools import pairwise

from geometry.design import SensorDesign
from studies.paper.document import Grid, Picture, Section, Verdict
from studies.paper.sections.words import listed, whole_percent
from studies.paper.spacing import LOADS, PRESSED_N, RINGS, Spaced, Spacing
from tripillar.pipeline.printed import LARGEST_FORCE_N, SPACING_MM

SPACING = "spacing.png"
QUIET = 0.05  #: share of its own that a unit may move by a neighbour's load and be called undisturbed


def section(found: Spacing, design: SensorDesign) -> Section:
    """The claim, tested by what neighbours and touches do at each pitch."""
    return Section(
        anchor="spacing",
        title="Spacing: units 1 to 2 cm apart",
        verdict=Verdict(reproduces=_felt(found), better=_undone(found), cannot=_disturbed(found)),
        blocks=[
            "The paper concludes from figure 7 that for a load on around 1 cm² units belong around 1–2 cm apart, "
            "since otherwise they hardly feel a touch further off, and that its structure avoids direct interference "
            "among the electrodes. Both are put to numbers here: the lightest touch that is felt wherever it falls, "
            "and what a loaded unit does to its neighbours.",
            _answer(found),
            Picture(
                file=SPACING,
                shows="Displacement of electrodes against distance, lightest felt touch and condition against pitch",
                caption=(
                    "**Spacing.** Left: displacement of every electrode by a normal load on one pad, over the loaded "
                    "unit's, at all pitches where the paper's unit fits; the line is the endless layer. Middle: what a "
                    "load does to readings of its neighbours. Right: the lightest touch of "
                    f"{found.asked.touch_mm / 10:g} × {found.asked.touch_mm / 10:g} cm that is felt wherever it falls."
                ),
            ),
            _neighbours(found),
            _touches(found),
            _decay(found),
            _smallest(found, design),
        ],
    )


def _answer(found: Spacing) -> str:
    """Whether 1 to 2 cm leave units undisturbed, in a sentence or two."""
    by_ring = {k: max(one.reading_share[load][k - 1] for one in _fitting(found) for load in LOADS) for k in RINGS}
    widest = found.at(SPACING_MM[1])
    share = max(widest.reading_share[load][0] for load in LOADS)
    quiet = [k for k in RINGS if by_ring[k] <= QUIET]
    if share <= QUIET:
        verdict = f"At {widest.pitch_mm:g} mm units leave one another alone"
    else:
        verdict = f"No: even at {widest.pitch_mm:g} mm units disturb one another"
    beyond = (
        f"neighbours {quiet[0]} pitches away stay below {whole_percent(QUIET)} at every pitch where the paper's unit "
        "fits"
        if quiet
        else f"even {RINGS[-1]} pitches away some reading changes by more than {whole_percent(QUIET)} at some pitch"
    )
    return (
        f"**Is 1 to 2 cm enough for units not to disturb one another?** {verdict}: a neighbour's reading changes by "
        f"up to {whole_percent(share)} of what the loaded unit's own does; {beyond}."
    )


def _felt(found: Spacing) -> str:
    """The claim on touches: whether it takes more force the wider the units are apart."""
    touches = [touch for touch in found.touches if touch.pitch_mm >= SPACING_MM[1]]
    fades = all(a.worst_n[load] < b.worst_n[load] for a, b in pairwise(touches) for load in LOADS)
    at, last = found.touch_at(SPACING_MM[1]), found.touches[-1]
    felt = [touch.pitch_mm for touch in found.touches if max(touch.worst_n.values()) <= PRESSED_N]
    limit = (
        f"1 MPa on 1 cm² is felt everywhere up to {max(felt):g} mm" if felt else "1 MPa on 1 cm² is missed at places"
    )
    return (
        f"{'Touches fade' if fades else 'Not that touches fade'} where units are more than 2 cm apart: the lightest "
        f"normal touch felt wherever it falls is {at.worst_n['normal']:.0f} N at {at.pitch_mm:g} mm and "
        f"{last.worst_n['normal']:.0f} N at {last.pitch_mm:g} mm, a tangential one {at.worst_n['tangential']:.0f} "
        f"and {last.worst_n['tangential']:.0f} N; {limit}."
    )


def _undone(found: Spacing) -> str:
    """What is gained by knowing the response."""
    first, last = _fitting(found)[0], found.at(SPACING_MM[1])
    return (
        "What neighbours do to each other is in the response and can be undone: the map from all forces to all "
        f"readings has condition number {first.condition:.0f} at {first.pitch_mm:g} mm and {last.condition:.1f} at "
        f"{last.pitch_mm:g} mm, so that noise of {100 * found.asked.noise:g} % in the readings costs Fz "
        f"{first.noise_n['fz']:.1f} and {last.noise_n['fz']:.1f} N."
    )


def _disturbed(found: Spacing) -> str:
    """The claim on interference."""
    closest, widest = _fitting(found)[0], found.at(SPACING_MM[1])
    normal, tangential = (
        f"{whole_percent(closest.reading_share[load][0])} to {whole_percent(widest.reading_share[load][0])}"
        for load in ("normal", "tangential")
    )
    quiet = max(widest.reading_share[load][0] for load in LOADS) <= QUIET
    claim = (
        "Nothing: units so spaced are independent" if quiet else "Independence of the units: so spaced they interfere"
    )
    return (
        f"{claim}: from {closest.pitch_mm:g} to {widest.pitch_mm:g} mm a normal load changes a reading next door by "
        f"{normal} of the loaded unit's own, a tangential one by {tangential}."
    )


def _fitting(found: Spacing) -> list[Spaced]:
    """Pitches at which the paper's unit fits."""
    return [one for one in found.spaced if one.pitch_mm >= found.smallest_mm]


def _neighbours(found: Spacing) -> Grid:
    header = ["pitch [mm]", "span [mm]", "pad [mm]"]
    header += [f"{load}, {k}" for load in LOADS for k in RINGS]
    header += ["condition", "Fx [N]", "Fy [N]", "Fz [N]"]
    return Grid(
        title=(
            "Largest change of a reading 1, 2 and 3 pitches away, over the loaded unit's own; condition number "
            f"of the joint map; least error at {100 * found.asked.noise:g} % noise"
        ),
        header=header,
        rows=[
            [
                f"{one.pitch_mm:g}",
                f"{one.span_mm:g}",
                f"{one.pad_mm:g}",
                *(f"{100 * share:.1f} %" for load in LOADS for share in one.reading_share[load]),
                f"{one.condition:.1f}",
                *(f"{error:.2f}" for error in one.noise_n.values()),
            ]
            for one in found.spaced
        ],
    )


def _touches(found: Spacing) -> Grid:
    return Grid(
        title=(
            f"Lightest touch of 1 cm² [N] that moves some reading by {found.asked.sure:g} times a noise of "
            f"{100 * found.asked.noise:g} %, by where it falls"
        ),
        header=["pitch [mm]", *(f"{load}, {place}" for load in LOADS for place in ("worst place", "best place"))],
        rows=[
            [
                f"{one.pitch_mm:g}",
                *(f"{where[load]:.1f}" for load in LOADS for where in (one.worst_n, one.best_n)),
            ]
            for one in found.touches
        ],
    )


def _decay(found: Spacing) -> str:
    off = found.fitted_mm / found.decay_mm - 1
    missed = [touch.pitch_mm for touch in found.touches if touch.worst_n["normal"] > LARGEST_FORCE_N]
    light = (
        f" The {LARGEST_FORCE_N:g} N that the paper states as the largest force are missed at some place from "
        f"{min(missed):g} mm on."
        if missed
        else ""
    )
    return (
        "**How influence decays.** Far from a load the surface of a layer bonded to a rigid base moves as "
        f"exp(−r/λ)/√r with λ = {found.decay_mm:.2f} mm for a slab of this height and Poisson's ratio "
        "(`fem.array.layer`: cos x = x and λ = 1.35 heights where nothing can be compressed). Electrodes "
        f"beyond {found.asked.far:g} heights, rims left out, fit λ = {found.fitted_mm:.1f} mm, "
        f"{whole_percent(abs(off))} {'more' if off > 0 else 'less'}. λ is a matter of the height: thinner slabs may "
        "have their units closer." + light
    )


def _smallest(found: Spacing, design: SensorDesign) -> str:
    narrow = [one for one in found.spaced if one.pitch_mm < found.smallest_mm]
    if not narrow:
        return f"The paper's unit fits at every pitch looked at, since it takes {found.smallest_mm:.2f} mm."
    spans = listed(f"{one.span_mm:g}" for one in narrow)
    return (
        f"**Below {found.smallest_mm:.2f} mm** the paper's unit, span {design.unit.span_mm:g} mm and the width of an "
        "oblique pillar, does not fit: pillars of neighbours would merge, and such a design is refused. The paper's "
        f"1 cm can be had with a narrower unit only, so at {listed(f'{one.pitch_mm:g}' for one in narrow)} mm the "
        f"span is {spans} mm, the widest that fits. Pads keep {design.pad.size_mm:g} mm, which covers both "
        "electrodes, but may not overlap: at these pitches they are as wide as the pitch, neighbours touch, and the "
        f"condition number is {listed(f'{one.condition:.0f}' for one in narrow)}."
    )
