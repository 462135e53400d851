"""The scenes that benchmark and references share, by name."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fem.scene.scene import Block, Inclusion, Load, Pillar, Probe, Scene, Sensor
from geometry.design import Array, Material, SensorDesign
from geometry.layout import AXES, FloatArray, electrode_squares, pad_squares

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


def response_scenes(design: SensorDesign | None = None, name: str = "response") -> dict[str, Scene]:
    """Columns of an array's response: 1 N along each axis on an inner, an edge and a corner pad.

    The probes are all electrodes, named by unit and electrode: their displacement [mm] is the influence [mm/N].
    """
    design = design or SensorDesign()
    cols = design.array.cols
    units = {"inner": design.array.rows // 2 * cols + cols // 2, "edge": cols // 2, "corner": 0}
    electrodes = tuple(
        Probe(
            name=f"{number // 2}-U{number % 2 + 1}",
            kind="mean",
            center_mm=((x0 + x1) / 2, (y0 + y1) / 2),
            size_mm=(x1 - x0, y1 - y0),
        )
        for number, (x0, y0, x1, y1) in enumerate(electrode_squares(design).tolist())
    )
    tractions_mpa = np.eye(3) / design.pad.size_mm**2
    return {
        f"{name}-{place}-{axis}": Scene(
            body=Sensor(design=design),
            material=design.matrix_material,
            loads=_on_pads(design, {unit: traction}),
            probes=electrodes,
        )
        for place, unit in units.items()
        for axis, traction in zip(AXES, tractions_mpa, strict=True)
    }


def field_scene(design: SensorDesign) -> Scene:
    """A small array under a random load on every pad, its displacement wanted at five random points of every unit."""
    rng = np.random.default_rng(0)
    units, (pitch, height) = design.n_units, (design.array.pitch_mm, design.unit.height_mm)
    tractions_mpa = rng.uniform((-0.3, -0.3, -1.0), (0.3, 0.3, -0.2), (units, 3))
    points = rng.uniform((-0.45, -0.45, 0.1), (0.45, 0.45, 0.9), (units, 5, 3)) * (pitch, pitch, height)
    points[:, :, :2] += (pad_squares(design)[:, None, :2] + pad_squares(design)[:, None, 2:]) / 2
    probes = tuple(
        Probe(name=f"{unit}-{number}", kind="point", position_mm=tuple(points[unit, number].tolist()))
        for unit, number in np.ndindex(units, 5)
    )
    loads = _on_pads(design, dict(enumerate(tractions_mpa)))
    return Scene(body=Sensor(design=design), material=design.matrix_material, loads=loads, probes=probes)


def small_array_scenes() -> dict[str, Scene]:
    """2 × 2 units: columns and points inside where pillars are six times as stiff as the matrix; points where alike."""
    plain = SensorDesign(array=Array(rows=2, cols=2))
    oblique = replace(plain, matrix_material=Material(young_mpa=1.0))
    fields = {"oblique-field": field_scene(oblique), "plain-field": field_scene(plain)}
    return response_scenes(oblique, "oblique") | fields


def _on_pads(design: SensorDesign, tractions_mpa: Mapping[int, FloatArray]) -> tuple[Load, ...]:
    squares = pad_squares(design)
    return tuple(
        Load(
            center_mm=tuple(((squares[unit, :2] + squares[unit, 2:]) / 2).tolist()),
            size_mm=tuple((squares[unit, 2:] - squares[unit, :2]).tolist()),
            traction_mpa=tuple(traction.tolist()),
        )
        for unit, traction in tractions_mpa.items()
    )


def hard_scenes() -> dict[str, Scene]:
    """What is hard to solve: rubbers 20 to 1000 times apart, a thin plate that keeps its volume, pillars that lean."""

    def upright(
        x: float, y: float, z: tuple[float, float], section: tuple[float, float], young: float, poisson: float
    ) -> Inclusion:
        material = Material(young_mpa=young, poisson=poisson)
        return Inclusion(base_mm=(x, y, z[0]), top_mm=(x, y, z[1]), section_mm=section, material=material)

    soft, dense = Material(young_mpa=1.0, poisson=0.495), Material(young_mpa=6.1, poisson=0.4999)
    sheared = Pillar(section_mm=(3.0, 2.0), base_mm=(0.0, 0.0, 0.0), top_mm=(6.0, 4.0, 8.0))
    leaning = Pillar(section_mm=(3.0, 2.0), base_mm=(1.0, 2.0, 0.0), top_mm=(10.0, 2.0, 6.0))
    return {
        "two-inclusions": _loaded(
            Block(size_mm=(20.0, 18.0, 8.0)),
            soft,
            ((10.0, 9.0), (7.0, 6.0), (0.02, 0.01, -0.1)),
            upright(7.0, 8.0, (0.0, 8.0), (3.0, 3.0), 30.0, 0.495),
            upright(13.5, 10.0, (0.0, 8.0), (2.5, 3.5), 0.05, 0.495),
        ),
        "void": _loaded(
            Block(size_mm=(15.0, 15.0, 10.0)),
            RUBBER,
            ((7.0, 8.0), (8.0, 7.0), (0.1, 0.05, -0.5)),
            upright(6.0, 7.0, (2.0, 7.0), (4.0, 3.0), 0.0061, 0.3),
        ),
        "plate": _loaded(Block(size_mm=(20.0, 20.0, 1.0)), dense, ((9.0, 11.0), (6.0, 5.0), (0.3, 0.1, -1.0))),
        "sheared-pillar": _loaded(sheared, dense, ((6.0, 4.0), (3.0, 2.0), (0.02, 0.01, -0.1))),
        "side-inclusion": _loaded(
            Block(size_mm=(16.0, 14.0, 8.0)),
            RUBBER,
            ((9.0, 7.0), (7.0, 6.0), (0.1, 0.05, -0.5)),
            upright(2.0, 7.0, (0.0, 8.0), (4.0, 5.0), 300.0, 0.45),
        ),
        "leaning-56": _loaded(leaning, RUBBER, ((10.0, 2.0), (3.0, 2.0), (0.02, 0.0, -0.1))),
    }


def _loaded(
    body: Block | Pillar,
    material: Material,
    load: tuple[tuple[float, float], tuple[float, float], tuple[float, float, float]],
    *inclusions: Inclusion,
) -> Scene:
    centre, size, traction = load
    return Scene(
        body=body,
        material=material,
        inclusions=inclusions,
        loads=(Load(center_mm=centre, size_mm=size, traction_mpa=traction),),
        probes=(Probe(name="patch", kind="mean", center_mm=centre, size_mm=size),),
    )


def all_scenes() -> dict[str, Scene]:
    """Every scene that has a reference."""
    return (
        patch_scenes()
        | pillar_scenes()
        | inclusion_scenes()
        | slab_scenes()
        | response_scenes()
        | small_array_scenes()
        | hard_scenes()
    )


def _mean(name: str, centre_mm: tuple[float, float], size_mm: float) -> Probe:
    return Probe(name=name, kind="mean", center_mm=centre_mm, size_mm=(size_mm, size_mm))
