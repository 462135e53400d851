"""Press a shape into the array's top."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.errors import DesignError
from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, design_of, to_write

if TYPE_CHECKING:
    from fem.contact import Contact, Shape

    Indenter = Shape | File
    Pair = tuple[float, float] | str
else:
    Indenter = Pair = str

MAX_STEEPNESS = 0.5  #: beyond, rubber beside the shape is strained by more than some 10 %
STRAIN_CAP = 0.3  #: beyond, linear strain is far off
SIZES = {
    "sphere": ("radius_mm",),
    "cylinder": ("radius_mm", "length_mm", "turn_deg"),
    "flat": ("radius_mm", "size_mm", "turn_deg"),
}


def press(
    design: DesignLike | None = None,
    *,
    shape: Indenter,
    depth_mm: float,
    radius_mm: float | None = None,
    size_mm: Pair | None = None,
    length_mm: float | None = None,
    turn_deg: float | None = None,
    at_mm: Pair = "0,0",
    slide_mm: Pair = "0,0",
    friction: float = 0.0,
    out: File | None = None,
    picture: File | None = None,
) -> "Contact":
    """Press a rigid shape into the sensor, and drag it along: contact with friction.

    Strain is linear: depths of more than a tenth of the slab's height are only roughly right.

    Parameters
    ----------
    design : SensorDesign or path, optional
        Design file (TOML); default: the paper's sensor.
    shape : str or Shape
        Indenter: sphere, cylinder, flat, or an STL file.
    depth_mm : float
        Depth of its lowest point below the top at rest [mm].
    radius_mm : float, optional
        Radius of a sphere, a lying cylinder or a round flat punch [mm].
    size_mm : str, optional
        Sides SIDE or SIDE,SIDE of a flat punch along x and y [mm].
    length_mm : float, optional
        Length of a cylinder [mm]; default: endless.
    turn_deg : float, optional
        Angle of a cylinder's axis, or of a flat punch, from x towards y [degrees].
    at_mm : str or tuple of float
        Place X,Y of its middle [mm]; the array's is 0,0.
    slide_mm : str or tuple of float
        Displacement X,Y along the top after it was pressed [mm].
    friction : float
        Coulomb's coefficient of friction.
    out : path, optional
        NetCDF file: a sample, and maps of the contact.
    picture : path, optional
        PNG file of the contact.

    Returns
    -------
    Contact
        ``force_n`` of each unit (rows, cols, 3), the net force, its moment and centre, and the contact's area.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> contact = press(design, shape="sphere", radius_mm=20.0, depth_mm=0.2)
    >>> contact.force_n.shape, bool(contact.net_force_n[2] > 0)
    ((1, 2, 3), True)
    """
    caller = current()
    file = to_write("out", out, ".nc", read=(design,))
    drawn = to_write("picture", picture, ".png", read=(design,))
    sizes = {"radius_mm": radius_mm, "size_mm": size_mm, "length_mm": length_mm, "turn_deg": turn_deg}
    sensor, at, slide = design_of(design), _pair("at_mm", at_mm), _pair("slide_mm", slide_mm)
    from dataset.indentation import largest_strain, write_contact
    from fem.contact import press as pressed
    from tripillar.face.tables import contact_table

    bars = caller.bars
    indenter = _shape(shape, {name: given for name, given in sizes.items() if given is not None})
    begin = cache(lambda: bars.begin("compliance of the top", total=1))  # no bar where it is in the cache
    contact = pressed(
        sensor, indenter, depth_mm, at_mm=at, slide_mm=slide, friction=friction,
        progress=lambda step: begin()(0, step),
    )  # fmt: skip
    strain = largest_strain(contact)
    if file is not None:
        write_contact(contact, file)
    if drawn is not None:
        from fem.pictures.contact import draw_contact

        draw_contact(contact, drawn)
    caller.answer(lambda: _as_plain(contact, strain), lambda: [contact_table(contact, strain)], file, drawn)
    if contact.steepness > MAX_STEEPNESS:
        caller.say(
            f"warning: it goes {contact.steepness:.2g} times half the contact's width deep: linear strain ends near "
            f"{MAX_STEEPNESS:g}; press less deep, or with a wider shape"
        )
    if strain > STRAIN_CAP:
        caller.say(
            f"warning: a pillar is strained by {strain:.0%}: linear strain ends near {STRAIN_CAP:.0%}; press less deep"
        )
    return contact


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


def _shape(name: "Indenter", given: dict[str, Any]) -> "Shape":
    """The indenter that a name and sizes describe."""
    from fem.contact import Cylinder, Flat, Sphere, Turned, read_solid

    if not isinstance(name, Path | str):
        return name
    kind = str(name)
    if not kind.lower().endswith(".stl") and kind not in SIZES:
        raise DesignError(f"shape={kind}: must be sphere, cylinder, flat, or a file that ends in .stl.")
    known = SIZES.get(kind, ())
    surplus = [size for size in given if size not in known]
    if surplus:
        takes = " and ".join(f"{size}=" for size in known) or "no sizes"
        raise DesignError(f"{surplus[0]}= is not of shape={kind}, which takes {takes}.")
    if not known:
        return read_solid(Path(kind))
    if kind == "flat":
        if ("radius_mm" in given) == ("size_mm" in given):
            raise DesignError("shape=flat needs radius_mm= (a disc) or size_mm= (a rectangle): give one of them.")
        if "radius_mm" in given:
            return Flat(radius_mm=given["radius_mm"])
        return Turned(Flat(_pair("size_mm", given["size_mm"], alone=True)), given.get("turn_deg", 0.0))
    if "radius_mm" not in given:
        raise DesignError(f"shape={kind} needs radius_mm= too.")
    radius_mm = given.pop("radius_mm")
    turn_deg = given.pop("turn_deg", 0.0)
    return Sphere(radius_mm) if kind == "sphere" else Turned(Cylinder(radius_mm, **given), turn_deg)


def _pair(name: str, given: "Pair", alone: bool = False) -> tuple[float, float]:
    """Numbers along x and y; one that may stand alone is both."""
    if not isinstance(given, str):
        return given
    try:
        x, y = map(float, given.split(",") * (2 if alone and "," not in given else 1))
    except ValueError:
        raise DesignError(f"{name}={given}: must be two numbers, such as 7.5,-3.") from None
    return x, y
