"""The scenes that benchmark and references share, by name."""

import math

from fem.scene import Block, Inclusion, Load, Pillar, Probe, Scene, Sensor
from geometry.design import Material, SensorDesign
from geometry.layout import AXES, electrode_squares, pad_squares

DOWN = (0.0, 0.0, -1.0)  #: traction [MPa]
ALONG_X = (0.2, 0.0, 0.0)
RUBBER = Material(young_mpa=6.1, poisson=0.49)


def patch_scenes() -> dict[str, Scene]:
    """A 10 mm patch in the middle of a 30 × 30 × 10 mm block, for three Poisson's ratios."""
    scenes = {}
    for poisson in (0.3, 0.49, 0.4999):
        for name, traction in {"normal": DOWN, "tangential": ALONG_X}.items():
            scenes[f"block-{name}-{poisson:g}"] = Scene(
                body=Block(size_mm=(30.0, 30.0, 10.0)),
                material=Material(young_mpa=6.1, poisson=poisson),
                loads=(Load(center_mm=(15.0, 15.0), size_mm=(10.0, 10.0), traction_mpa=traction),),
                probes=(_mean("patch", (15.0, 15.0), 10.0),),
            )
    return scenes


def pillar_scenes() -> dict[str, Scene]:
    """An upright and an oblique free pillar, loaded all over the top."""
    oblique_mm = 2.0 * math.sqrt(2.0)
    bodies = {
        "upright": Pillar(section_mm=(2.0, 2.0), base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, 10.0)),
        "oblique": Pillar(section_mm=(oblique_mm, 2.0), base_mm=(10.0, 0.0, 0.0), top_mm=(0.0, 0.0, 10.0)),
    }
    tractions = {"normal": DOWN, "tangential": ALONG_X}
    return {
        f"pillar-{kind}-{name}": Scene(
            body=body,
            material=RUBBER,
            loads=(Load(center_mm=(0.0, 0.0), size_mm=body.section_mm, traction_mpa=traction),),
            probes=(Probe(name="top", kind="mean", center_mm=(0.0, 0.0), size_mm=body.section_mm),),
        )
        for kind, body in bodies.items()
        for name, traction in tractions.items()
    }


def slab_scenes() -> dict[str, Scene]:
    """One loaded patch of a 90 × 90 × 10 mm slab, probed there and where its neighbours would be."""
    centres = {
        "self": (52.5, 52.5),
        "first": (37.5, 52.5),
        "diagonal": (37.5, 37.5),
        "second": (22.5, 52.5),
        "edge": (82.5, 52.5),
    }
    return {
        f"slab-{size:g}-{name}": Scene(
            body=Block(size_mm=(90.0, 90.0, 10.0)),
            material=RUBBER,
            loads=(Load(center_mm=centres["self"], size_mm=(size, size), traction_mpa=traction),),
            probes=tuple(_mean(place, centre, size) for place, centre in centres.items()),
        )
        for size in (12.0, 4.0)
        for name, traction in {"normal": DOWN, "tangential": ALONG_X}.items()
    }


def inclusion_scenes() -> dict[str, Scene]:
    """A stiff upright pillar, from base to top, in a soft block."""
    stiff = Inclusion(
        base_mm=(7.5, 7.5, 0.0),
        top_mm=(7.5, 7.5, 10.0),
        section_mm=(2.0, 2.0),
        material=Material(young_mpa=61.0, poisson=0.49),
    )
    return {
        f"stiff-pillar-{name}": Scene(
            body=Block(size_mm=(15.0, 15.0, 10.0)),
            material=Material(young_mpa=0.61, poisson=0.49),
            inclusions=(stiff,),
            loads=(Load(center_mm=(7.5, 7.5), size_mm=(12.0, 12.0), traction_mpa=traction),),
            probes=(_mean("patch", (7.5, 7.5), 12.0), _mean("pillar", (7.5, 7.5), 2.0)),
        )
        for name, traction in {"normal": (0.0, 0.0, -0.1), "tangential": (0.02, 0.0, 0.0)}.items()
    }


def response_scenes(design: SensorDesign | None = None) -> dict[str, Scene]:
    """Columns of the homogeneous array's response: 1 N on an inner pad along each axis, and a corner pad along z.

    The probes are all electrodes, named by unit and electrode: their displacement [mm] is the influence [mm/N].
    """
    design = design or SensorDesign()
    cols = design.array.cols
    inner = design.array.rows // 2 * cols + cols // 2
    electrodes = tuple(
        Probe(
            name=f"{number // 2}-U{number % 2 + 1}",
            kind="mean",
            center_mm=((x0 + x1) / 2, (y0 + y1) / 2),
            size_mm=(x1 - x0, y1 - y0),
        )
        for number, (x0, y0, x1, y1) in enumerate(electrode_squares(design).tolist())
    )
    area_mm2 = design.pad.size_mm**2
    scenes = {}
    for place, unit, axes in (("inner", inner, "xyz"), ("corner", 0, "z")):
        x0, y0, x1, y1 = pad_squares(design)[unit].tolist()
        for name in axes:
            axis = AXES.index(name)
            traction = [0.0, 0.0, 0.0]
            traction[axis] = 1 / area_mm2
            scenes[f"response-{place}-{name}"] = Scene(
                body=Sensor(design=design),
                material=design.matrix_material,
                loads=(
                    Load(
                        center_mm=((x0 + x1) / 2, (y0 + y1) / 2),
                        size_mm=(x1 - x0, y1 - y0),
                        traction_mpa=(traction[0], traction[1], traction[2]),
                    ),
                ),
                probes=electrodes,
            )
    return scenes


def all_scenes() -> dict[str, Scene]:
    """Every scene that has a reference."""
    return patch_scenes() | pillar_scenes() | inclusion_scenes() | slab_scenes() | response_scenes()


def _mean(name: str, centre_mm: tuple[float, float], size_mm: float) -> Probe:
    return Probe(name=name, kind="mean", center_mm=centre_mm, size_mm=(size_mm, size_mm))
