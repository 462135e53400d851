"""Scene files: TOML read into a `Scene`, unknown keys and nonsense refused in one line that names the place."""

import reprlib
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from common.errors import SceneError
from common.storage.files import stated
from common.storage.text_file import StrictTables, read_text, tables_of
from fem.kernel.loads import LOAD_KINDS, Load
from fem.scene.scene import Block, Body, Inclusion, Pillar, Probe, Scene, Sensor
from geometry.design import Material, SensorDesign
from geometry.design_file import MATERIALS, design_from_dict, with_silicones
from geometry.law import RATIOS
from geometry.silicones import of_silicone

STRICT = StrictTables(SceneError)
BODIES: dict[str, type[Body]] = {"block": Block, "pillar": Pillar, "unit": Sensor, "array": Sensor}
MATERIAL_KEYS = ("young_mpa", "poisson")


def read_scene(path: Path) -> Scene:
    """Read a scene file; `SceneError`, which begins with the path, if it is missing, not TOML, or not a scene."""
    return scene_from_toml(read_text(path, "give a scene, such as one of scenes/", SceneError), str(path))


def scene_from_toml(text: str, source: str = "the scene") -> Scene:
    """A scene from the text of a TOML file; errors as in `read_scene`."""
    return scene_from_dict(tables_of(text, source, SceneError), source)


def scene_from_dict(table: dict[str, Any], source: str = "the scene") -> Scene:
    """A scene from the nested tables of a TOML file; `SceneError` for a key or a value that makes no sense.

    In bodies of kind unit and array the table `design` holds the keys of a design file; what it lacks is the paper's. A
    table `material` there is the rubber of pillars and matrix alike, but for those that `design` gives itself; its
    model is that of all rubbers that state none.
    """
    scene: Scene = STRICT.made(source, _scene, table=table)
    return scene


def _scene(table: dict[str, Any]) -> Scene:
    body_table = _needed(table, "body", "")
    if "kind" not in body_table:
        raise SceneError(f"[body]: kind is missing; it must be one of {', '.join(BODIES)}.")
    kind = _known(body_table["kind"], BODIES, "[body]")
    is_sensor = BODIES[kind] is Sensor
    own = {"block": ("material", "inclusion"), "pillar": ("material",)}.get(kind, ("material", "design"))
    STRICT.require_keys(table, ("body", *own, "load", "probe", "solve"), f" in a scene of kind {kind}")
    needed = () if is_sensor else keys_of(BODIES[kind])
    STRICT.require_keys(body_table, ("kind", *needed), " in [body]", needed)

    material = None
    if "material" in table:
        table = table | {"material": STRICT.made("[material]", of_silicone, table=table["material"])}
    if "material" in table or not is_sensor:
        rubber = _needed(table, "material", "; it holds young_mpa and poisson")
        material = STRICT.filled("[material]", Material, rubber, (*MATERIAL_KEYS, "model", *RATIOS), MATERIAL_KEYS)
    if is_sensor:
        design = _design(STRICT.table(table, "design"), material)
        given, material = {"design": design, "kind": kind}, design.matrix_material
    else:
        given = {key: body_table[key] for key in needed}
    assert material is not None  # a block and a pillar need one
    solve = STRICT.table(table, "solve")
    STRICT.require_keys(solve, ("tolerance",), " in [solve]")
    return Scene(
        body=STRICT.made("[body]", BODIES[kind], **given),
        material=material,
        inclusions=tuple(_inclusion(*entry, material.model) for entry in STRICT.entries(table, "inclusion")),
        loads=tuple(_load(*entry) for entry in STRICT.entries(table, "load")),
        probes=tuple(
            STRICT.filled(place, Probe, entry, keys_of(Probe, optional=True), keys_of(Probe))
            for place, entry in STRICT.entries(table, "probe")
        ),
        **solve,
    )


def keys_of(made: type[Any], optional: bool = False) -> tuple[str, ...]:
    """Keys that a file must give for a part of a scene, or with `optional` all that it may."""
    return tuple(spec.name for spec in fields(made) if optional or spec.default is MISSING)


def _known(kind: Any, kinds: dict[str, Any], place: str) -> str:
    if not isinstance(kind, str) or kind not in kinds:
        raise SceneError(f"{place}: kind={reprlib.repr(kind)} is unknown; it must be one of {', '.join(kinds)}.")
    return kind


def _needed(table: dict[str, Any], key: str, meaning: str) -> dict[str, Any]:
    if key not in table:
        raise SceneError(f"the table [{key}] is missing{meaning}.")
    return STRICT.table(table, key)


def _design(table: dict[str, Any], material: Material | None) -> SensorDesign:
    """The design of a unit or an array; a common material fills the rubbers that the table does not give."""
    if material is not None:
        table = with_silicones(table)
        for name in MATERIALS:
            own = STRICT.table(table, name)
            table = table | {name: {"model": material.model} | own if own else stated(material)}
    return design_from_dict(table, "[design]")


def _load(place: str, entry: dict[str, Any]) -> Load:
    kind = _known(entry.get("kind", "dead"), LOAD_KINDS, place)
    given = {key: value for key, value in entry.items() if key != "kind"}
    made, of_kind = LOAD_KINDS[kind], f"{place} of kind {kind}" if "kind" in entry else place
    load: Load = STRICT.filled(of_kind, made, given, keys_of(made, optional=True), keys_of(made))
    return load


def _inclusion(place: str, entry: dict[str, Any], model: str) -> Inclusion:
    entry = STRICT.made(place, of_silicone, table=entry, model=model)
    prism = tuple(key for key in keys_of(Inclusion) if key != "material")
    keys = (*prism, *MATERIAL_KEYS)
    STRICT.require_keys(entry, (*keys, *RATIOS), f" in {place}", keys)
    own = {key: entry[key] for key in (*MATERIAL_KEYS, *RATIOS) if key in entry}
    material = STRICT.made(place, Material, **own, model=model)
    inclusion: Inclusion = STRICT.made(place, Inclusion, **{key: entry[key] for key in prism}, material=material)
    return inclusion
