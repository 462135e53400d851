"""The command that presses a shape into the array's top."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from geometry.errors import DesignError
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    answer,
    chosen,
    output_file,
    progress_bars,
    require_other,
    require_suffix,
    say,
    spelled,
)

if TYPE_CHECKING:
    from fem.contact import Contact, Shape

MAX_STEEPNESS = 0.5  #: beyond, rubber beside the shape is strained by more than some 10 %
STRAIN_CAP = 0.3  #: beyond, linear strain is far off
SIZES = {"sphere": ("radius",), "cylinder": ("radius", "length", "turn"), "flat": ("radius", "size", "turn")}


def press(
    shape: Annotated[str, typer.Option(metavar="SHAPE", help="Indenter: sphere, cylinder, flat, or an STL file.")],
    depth: Annotated[float, typer.Option(help="Depth of its lowest point below the top at rest [mm].")],
    radius: Annotated[
        float | None, typer.Option(help="Radius of a sphere, a lying cylinder or a round flat punch [mm].")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="SIDE[,SIDE]", help="Sides of a flat punch along x and y [mm].")
    ] = None,
    length: Annotated[float | None, typer.Option(help="Length of a cylinder [mm]; default: endless.")] = None,
    turn: Annotated[
        float | None, typer.Option(help="Angle of a cylinder's axis, or of a flat punch, from x towards y [degrees].")
    ] = None,
    at: Annotated[str, typer.Option(metavar="X,Y", help="Place of its middle [mm]; the array's is 0,0.")] = "0,0",
    slide: Annotated[
        str, typer.Option(metavar="X,Y", help="Displacement along the top after it was pressed [mm].")
    ] = "0,0",
    friction: Annotated[float, typer.Option(help="Coulomb's coefficient of friction.")] = 0.0,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", callback=output_file, help="NetCDF file: a sample, and maps of the contact."),
    ] = None,
    picture: Annotated[Path | None, typer.Option(callback=output_file, help="PNG file of the contact.")] = None,
    design: DesignOption = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Press a rigid shape into the sensor, and drag it along: contact with friction.

    Strain is linear: depths of more than a tenth of the slab's height are only roughly right.
    """
    require_other(out, design)
    require_suffix("--out", out, ".nc")
    require_suffix("--picture", picture, ".png")
    sizes = {"radius": radius, "size": size, "length": length, "turn": turn}
    from dataset.indentation import largest_strain, write_contact
    from fem.contact import press as pressed
    from tripillar.cli.tables import contact_table

    spellings = {"depth_mm": "--depth", "at_mm": "--at", "slide_mm": "--slide", "friction": "--friction"}
    spellings |= {"radius_mm": "--radius", "size_mm": "--size", "length_mm": "--length", "turn_deg": "--turn"}
    with spelled(**spellings), progress_bars(verbosity) as bars:
        indenter = _shape(shape, {name: given for name, given in sizes.items() if given is not None})
        begin = cache(lambda: bars.begin("compliance of the top", total=1))  # no bar where it is in the cache
        contact = pressed(
            chosen(design), indenter, depth, at_mm=_pair("--at", at), slide_mm=_pair("--slide", slide),
            friction=friction, progress=lambda step: begin()(0, step),
        )  # fmt: skip
    strain = largest_strain(contact)
    files = [path for path in (out, picture) if path is not None]
    if out is not None:
        write_contact(contact, out)
    if picture is not None:
        from fem.pictures.contact import draw_contact

        draw_contact(contact, picture)
    answer(json_, _as_plain(contact, strain), lambda: [contact_table(contact, strain)], *files)
    if contact.steepness > MAX_STEEPNESS:
        say(
            f"warning: it goes {contact.steepness:.2g} times half the contact's width deep: linear strain ends near "
            f"{MAX_STEEPNESS:g}; press less deep, or with a wider shape"
        )
    if strain > STRAIN_CAP:
        say(f"warning: a pillar is strained by {strain:.0%}: linear strain ends near {STRAIN_CAP:.0%}; press less deep")


def _as_plain(contact: "Contact", strain: float) -> dict[str, Any]:
    from dataset.indentation import samples_of

    x, y = contact.centre_mm.tolist()
    return {
        "net_force_n": contact.net_force_n.tolist(),
        "moment_nmm": contact.moment_nmm.tolist(),
        "centre_mm": [x, y],
        "area_mm2": contact.area_mm2,
        "peak_mpa": contact.peak_mpa,
        "error_estimate": contact.error_estimate,
        "electrode_error_estimate": contact.electrode_error_estimate,
        "sticking": contact.sticking,
        "steepness": contact.steepness,
        "largest_strain": strain,
        "force_n": contact.force_n.tolist(),
        "resistance_ohm": samples_of([contact]).resistance_ohm[0].tolist(),
    }


def _shape(name: str, given: dict[str, Any]) -> "Shape":
    """The indenter that the options describe."""
    from fem.contact import Cylinder, Flat, Sphere, read_solid

    if name.lower().endswith(".stl"):
        known: tuple[str, ...] = ()
    elif name in SIZES:
        known = SIZES[name]
    else:
        raise DesignError(f"--shape {name}: must be sphere, cylinder, flat, or a file that ends in .stl.")
    surplus = [option for option in given if option not in known]
    if surplus:
        takes = " and ".join(f"--{option}" for option in known) or "no sizes"
        raise DesignError(f"--{surplus[0]} is not of --shape {name}, which takes {takes}.")
    if not known:
        return read_solid(Path(name))
    if name == "flat":
        if ("radius" in given) == ("size" in given):
            raise DesignError("--shape flat needs --radius, a disc, or --size, a rectangle: give one of them.")
        if "radius" in given:
            return Flat(radius_mm=given["radius"])
        return Flat(_pair("--size", given["size"], alone=True), turn_deg=given.get("turn", 0.0))
    if "radius" not in given:
        raise DesignError(f"--shape {name} needs --radius.")
    if name == "sphere":
        return Sphere(given["radius"])
    more = {key: given[option] for option, key in (("length", "length_mm"), ("turn", "turn_deg")) if option in given}
    return Cylinder(given["radius"], **more)


def _pair(option: str, text: str, alone: bool = False) -> tuple[float, float]:
    """Numbers along x and y; one that may stand alone is both."""
    try:
        x, y = map(float, text.split(",") * (2 if alone and "," not in text else 1))
    except ValueError:
        raise DesignError(f"{option} {text}: must be two numbers, such as 7.5,-3.") from None
    return x, y
