"""Press a shape into the array's top."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from common.errors import DesignError
from common.quantity import quantity
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, Options, design_of, job

if TYPE_CHECKING:
    Indenter = stages.Shape | File
    Pair = tuple[float, float] | str
    Turn = float | tuple[float, float, float] | str | None
else:
    Indenter = Pair = Turn = str

Unit = Literal["mm", "cm", "m", "inch"]
MAX_STEEPNESS = 0.5  #: beyond, rubber beside the shape is strained by more than some 10 %
USUAL_DEPTH = 0.05  #: of the slab's height
#: at a fifth to a third of the height, from `python -m studies peers finite`
PUSHES_LESS = "neo-Hookean rubber pushes back 2 to 17 % less there under balls, 8 to 16 % under flat punches"
STRAIN_CAP = 0.3  #: beyond, linear strain is far off


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Sizes and place of an indenter about its middle; of a file's what its numbers mean."""

    radius_mm: float | None = quantity(None, "radius of a sphere, a lying cylinder or a round flat punch [mm]")
    size_mm: Pair | None = quantity(None, "sides SIDE or SIDE,SIDE of a flat punch along x and y [mm]")
    length_mm: float | None = quantity(None, "length of a cylinder [mm]; default: endless")
    turn_deg: Turn = quantity(
        None,
        "angle of a cylinder, flat punch or tool about z, from x towards y; or X,Y,Z of a tool about x, y, z [degrees]",
    )
    unit: Unit | None = quantity(
        None, "unit of a file's numbers; default: mm, if that makes a tool of a usual size; STEP states its own"
    )
    scale: float | None = quantity(None, "factor by which a tool is larger than in its file")


SIZES = Options(Sizes)
TOOL = Options(Sizes, "turn_deg", "unit", "scale")  #: of an indenter of a file
#: sizes of each shape, that which it needs first
SIZES_OF = {
    "sphere": ("radius_mm",),
    "cylinder": ("radius_mm", "length_mm", "turn_deg"),
    "flat": ("size_mm", "radius_mm", "turn_deg"),
}


@job(out=".nc", picture=".png")
def press(
    design: DesignLike | None = None,
    *,
    shape: Indenter,
    depth_mm: float | None = None,
    at_mm: Pair = "0,0",
    slide_mm: Pair = "0,0",
    friction: float = 0.0,
    out: File | None = None,
    picture: File | None = None,
    force: bool = False,
    **sizes: Annotated[Any, SIZES],
) -> "stages.Contact":
    """Press a rigid shape into the sensor, and drag it along: contact with friction.

    Linear strain is only roughly right deeper than a tenth of the slab's height. Other rubbers without friction are
    solved at finite strain, in 3 to 20 s of processor time.

    Parameters
    ----------
    design : SensorDesign or path, optional
        Design file (TOML); default: the paper's sensor.
    shape : str or Shape
        Indenter: sphere, cylinder, flat, or a file of a closed surface: STL, OBJ, PLY or STEP.
    depth_mm : float, optional
        Depth of its lowest point below the top at rest [mm]; default: a twentieth of the slab's height.
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
    force : bool
        Give a contact even if its estimated error is above 20 %.
    **sizes
        Fields of `pressing.Sizes`: radius_mm, size_mm, length_mm, turn_deg, unit and scale.

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
    caller, sensor = current(), design_of(design)
    depth_mm = USUAL_DEPTH * sensor.unit.height_mm if depth_mm is None else depth_mm
    indenter = _shape(shape, SIZES.of(sizes))
    begin = cache(lambda: caller.bars.begin("compliance of the top", total=1))  # no bar where it is in the cache
    contact = stages.press(
        sensor, indenter, depth_mm, at_mm=_numbers("at_mm", at_mm), slide_mm=_numbers("slide_mm", slide_mm),
        friction=friction, progress=lambda step: begin()(0, step),
    )  # fmt: skip
    model, least_mm = sensor.matrix_material.model, stages.LARGE_SHARE * sensor.unit.height_mm
    tangent = None if model == "linear" else stages.why_tangent(contact)
    is_linear = model == "linear" or tangent is not None
    if not is_linear:
        contact = stages.at_finite_strain(contact, caller.say)
    warning = stages.judge(contact, force)
    strain = stages.largest_strain(contact)
    if out is not None:
        stages.write_contact(contact, Path(out))
    if picture is not None:
        stages.draw_contact(contact, Path(picture))
    caller.answer(lambda: _as_plain(contact, strain), lambda: [stages.contact_table(contact, strain)], out, picture)
    for note in (*getattr(indenter, "notes", ()), *([warning] if warning else [])):
        caller.say(f"warning: {note}")
    if is_linear and contact.steepness > MAX_STEEPNESS:
        caller.say(
            f"warning: it goes {contact.steepness:.2g} times half the contact's width deep: linear strain ends near "
            f"{MAX_STEEPNESS:g}; press less deep, or with a wider shape"
        )
    if is_linear and strain > STRAIN_CAP:
        caller.say(
            f"warning: a pillar is strained by {strain:.0%}: linear strain ends near {STRAIN_CAP:.0%}; press less deep"
        )
    if tangent is not None:
        caller.say(
            f"warning: the contact of {model} rubber is that of its tangent at rest, as {tangent}; where the top moves "
            f"by more than {stages.LARGE_SHARE:g} of the slab's height, {least_mm:g} mm, finite strain tells: "
            f"{PUSHES_LESS}"
        )
    moved_mm = float(np.linalg.norm(contact.displacement_mm, axis=0).max())
    if is_linear and moved_mm > least_mm:
        caller.say(
            f"warning: the top moves by {moved_mm:.3g} mm, over {stages.LARGE_SHARE:g} of the slab's height of "
            f"{sensor.unit.height_mm:g} mm: {PUSHES_LESS}; press less deep, or write model = 'neo-hookean'"
        )
    return contact


def _as_plain(contact: "stages.Contact", strain: float) -> dict[str, Any]:
    arrays = ("net_force_n", "moment_nmm", "centre_mm", "force_n")
    names = ("area_mm2", "peak_mpa", "error_estimate", "electrode_error_estimate", "sticking", "steepness")
    plain = {name: getattr(contact, name).tolist() for name in arrays} | {
        name: getattr(contact, name) for name in names
    }
    ohms = stages.samples_of_contacts([contact]).resistance_ohm[0]
    return plain | {"largest_strain": strain, "resistance_ohm": ohms.tolist()}


def _shape(shape: "Indenter", given: dict[str, Any]) -> "stages.Shape":
    """The indenter that a name and sizes describe."""
    if not isinstance(shape, Path | str):
        return shape
    kind = str(shape)
    is_file = kind.lower().endswith(stages.TOOL_FILES)
    if not is_file and kind not in SIZES_OF:
        raise DesignError(
            f"shape={kind}: must be sphere, cylinder, flat, or a file that ends in {', '.join(stages.TOOL_FILES)}."
        )
    takes = TOOL.names if is_file else SIZES_OF[kind]
    if surplus := [size for size in given if size not in takes]:
        listed = " and ".join(f"{size}=" for size in takes) or "no sizes"
        raise DesignError(f"{surplus[0]}= is not of shape={kind}, which takes {listed}.")
    if is_file:
        return read_tool(kind, **given)
    if kind == "flat" and ("radius_mm" in given) == ("size_mm" in given):
        raise DesignError("shape=flat needs radius_mm= (a disc) or size_mm= (a rectangle): give one of them.")
    if kind != "flat" and "radius_mm" not in given:
        raise DesignError(f"shape={kind} needs radius_mm= too.")
    (angle,) = _numbers("turn_deg", given.pop("turn_deg", 0.0), "one angle, about z")
    turn = stages.about_z(angle)
    if kind == "flat" and "size_mm" in given:
        return stages.Flat(_numbers("size_mm", given["size_mm"], alone="{0},{0}"), turn=turn)
    return {"sphere": stages.Sphere, "cylinder": stages.Cylinder, "flat": stages.Flat}[kind](**given, turn=turn)


def read_tool(path: File, turn_deg: Turn = None, unit: str | None = None, scale: float | None = None) -> "stages.Solid":
    """The indenter of a file."""
    turned = _numbers("turn_deg", turn_deg or 0.0, "one about z or three angles, such as 180,0,45", "0,0,{}")
    return stages.read_solid(Path(path), unit, 1.0 if scale is None else scale, turned)


def _numbers(name: str, given: Any, like: str = "two numbers, such as 7.5,-3", alone: str = "") -> Any:
    """As many numbers as a text of examples has commas; what one that stands alone means has its place {}."""
    if not isinstance(given, str | int | float):
        return given
    try:
        numbers = tuple(map(float, (alone.format(given) if alone and "," not in str(given) else str(given)).split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) != like.count(","):
        raise DesignError(f"{name}={given}: must be {like}.")
    return numbers
