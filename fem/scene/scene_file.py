"""Scene files: TOML read into a `Scene`, unknown keys and nonsense refused in one line that names the place."""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from fem.scene.checks import SceneError, shown
from fem.scene.loads import LOAD_KINDS, Load
from fem.scene.scene import Block, Body, Inclusion, Pillar, Probe, Scene, Sensor
from geometry.design import Material, SensorDesign
from geometry.design_file import design_from_dict
from geometry.storage.files import stated
from geometry.storage.text_file import StrictTables, read_text, tables_of

STRICT = StrictTables(SceneError)
BODIES: dict[str, type[Body]] = {"block": Block, "pillar": Pillar, "unit": Sensor, "array": Sensor}
MATERIAL_KEYS = ("young_mpa", "poisson")
PRISM_KEYS = ("base_mm", "top_mm", "section_mm")
PROBE_KEYS = {"mean": ("center_mm", "size_mm"), "point": ("position_mm",)}


def read_scene(path: Path) -> Scene:
    """Read a scene file.

    Raises
    ------
    SceneError
        If the file is missing, not TOML, or not a scene; the message begins with the path.
    """
    return scene_from_toml(read_text(path, "give a scene, such as one of scenes/", SceneError), str(path))


def scene_from_toml(text: str, source: str = "the scene") -> Scene:
    """A scene from the text of a TOML file; errors as in `read_scene`."""
    return scene_from_dict(tables_of(text, source, SceneError), source)


def scene_from_dict(table: dict[str, Any], source: str = "the scene") -> Scene:
    """A scene from the nested tables of a TOML file.

    In bodies of kind unit and array the table `design` holds the keys of a design file; what it lacks is the paper's.
    A table `material` there is the rubber of pillars and matrix alike, but for those that `design` gives itself; its
    model is that of all rubbers that state none.

    Raises
    ------
    SceneError
        For an unknown or missing key, or a value that makes no sense.
    """
    scene: Scene = STRICT.made(source, _scene, table=table)
    return scene


def _scene(table: dict[str, Any]) -> Scene:
    body_table = _needed(table, "body", "")
    kind = body_table.get("kind")
    if not isinstance(kind, str) or kind not in BODIES:
        given = "kind is missing" if kind is None else f"kind={shown(kind)} is unknown"
        raise SceneError(f"[body]: {given}; it must be one of {', '.join(BODIES)}.")
    is_sensor = BODIES[kind] is Sensor
    needed = () if is_sensor else keys_of(BODIES[kind])
    own = {"block": ("material", "inclusion"), "pillar": ("material",)}.get(kind, ("material", "design"))
    STRICT.require_keys(table, ("body", *own, "load", "probe", "solve"), f" in a scene of kind {kind}")
    STRICT.require_keys(body_table, ("kind", *needed), " in [body]", needed)

    material = None
    if "material" in table or not is_sensor:
        rubber = _needed(table, "material", "; it holds young_mpa and poisson")
        material = STRICT.filled("[material]", Material, rubber, (*MATERIAL_KEYS, "model"), MATERIAL_KEYS)

    body: Body
    if is_sensor:
        design = _design(STRICT.table(table, "design"), material)
        body = STRICT.made("[body]", Sensor, design=design, kind=kind)
        material = design.matrix_material
    else:
        body = STRICT.made("[body]", BODIES[kind], **{key: body_table[key] for key in needed})

    solve = STRICT.table(table, "solve")
    STRICT.require_keys(solve, ("tolerance",), " in [solve]")
    material = material if material is not None else Material()
    return Scene(
        body=body,
        material=material,
        inclusions=tuple(_inclusion(*entry, material.model) for entry in STRICT.entries(table, "inclusion")),
        loads=tuple(_load(*entry) for entry in STRICT.entries(table, "load")),
        probes=tuple(_probe(*entry) for entry in STRICT.entries(table, "probe")),
        **solve,
    )


def keys_of(made: type[Body] | type[Load], optional: bool = False) -> tuple[str, ...]:
    """Keys that a file must give for a body or load, or with `optional` all that it may."""
    return tuple(spec.name for spec in fields(made) if optional or spec.default is MISSING)


def _needed(table: dict[str, Any], key: str, meaning: str) -> dict[str, Any]:
    if key not in table:
        raise SceneError(f"the table [{key}] is missing{meaning}.")
    return STRICT.table(table, key)


def _design(table: dict[str, Any], material: Material | None) -> SensorDesign:
    """The design of a unit or an array; a common material fills the rubbers that the table does not give."""
    if material is not None:
        for name in ("pillar_material", "matrix_material"):
            own = STRICT.table(table, name)
            table = table | {name: {"model": material.model} | own if own else stated(material)}
    return design_from_dict(table, "[design]")


def _load(place: str, entry: dict[str, Any]) -> Load:
    kind = entry.get("kind", "dead")
    if not isinstance(kind, str) or kind not in LOAD_KINDS:
        raise SceneError(f"{place}: kind={shown(kind)} is unknown; it must be one of {', '.join(LOAD_KINDS)}.")
    given = {key: value for key, value in entry.items() if key != "kind"}
    of_kind = f"{place} of kind {kind}" if "kind" in entry else place
    made = LOAD_KINDS[kind]
    STRICT.require_keys(given, keys_of(made, optional=True), f" in {of_kind}", keys_of(made))
    load: Load = STRICT.made(place, made, **given)
    return load


def _inclusion(place: str, entry: dict[str, Any], model: str) -> Inclusion:
    keys = (*PRISM_KEYS, *MATERIAL_KEYS)
    STRICT.require_keys(entry, keys, f" in {place}", keys)
    material = STRICT.made(place, Material, **{key: entry[key] for key in MATERIAL_KEYS}, model=model)
    prism = {key: entry[key] for key in PRISM_KEYS}
    inclusion: Inclusion = STRICT.made(place, Inclusion, **prism, material=material)
    return inclusion


def _probe(place: str, entry: dict[str, Any]) -> Probe:
    STRICT.require_keys(
        entry, ("name", "kind", *PROBE_KEYS["mean"], *PROBE_KEYS["point"]), f" in {place}", ("name", "kind")
    )
    kind = entry["kind"]
    if isinstance(kind, str) and kind in PROBE_KEYS:
        keys = PROBE_KEYS[kind]
        STRICT.require_keys(entry, ("name", "kind", *keys), f" in {place} of kind {kind}", keys)
    probe: Probe = STRICT.made(place, Probe, **entry)
    return probe
