"""Scene files: TOML read into a `Scene`, unknown keys and nonsense refused in one line that names the place."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fem.scene.scene import Block, Body, Inclusion, Load, Pillar, Probe, Scene, SceneError, Sensor, shown
from geometry.design import Material, SensorDesign
from geometry.design_file import design_from_dict
from geometry.errors import DesignError
from geometry.storage.text_file import read_text, tables_of

BODY_KEYS = {
    "block": ("size_mm",),
    "pillar": ("section_mm", "base_mm", "top_mm"),
    "unit": (),
    "array": (),
}
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
    A table `material` there is the rubber of pillars and matrix alike, but for those that `design` gives itself.

    Raises
    ------
    SceneError
        For an unknown or missing key, or a value that makes no sense.
    """
    try:
        return _scene(table)
    except (SceneError, DesignError) as error:
        raise SceneError(f"{source}: {error}") from None


def _scene(table: dict[str, Any]) -> Scene:
    body_table = _table(table, "body")
    kind = body_table.get("kind")
    if not isinstance(kind, str) or kind not in BODY_KEYS:
        given = "kind is missing" if kind is None else f"kind={shown(kind)} is unknown"
        raise SceneError(f"[body]: {given}; it must be one of {', '.join(BODY_KEYS)}.")
    is_sensor = kind in ("unit", "array")
    own = {"block": ("material", "inclusion"), "pillar": ("material",)}.get(kind, ("material", "design"))
    _require_keys(table, ("body", *own, "load", "probe", "solve"), f" in a scene of kind {kind}", required=("body",))
    _require_keys(body_table, ("kind", *BODY_KEYS[kind]), " in [body]", required=BODY_KEYS[kind])

    material = None
    if "material" in table:
        material = _filled("[material]", Material, _table(table, "material"), MATERIAL_KEYS)
    elif not is_sensor:
        raise SceneError("the table [material] is missing; it holds young_mpa and poisson.")

    body: Body
    if is_sensor:
        design = _design(_table(table, "design") if "design" in table else {}, material)
        body = _placed("[body]", Sensor, design=design, kind=kind)
        material = design.matrix_material
    else:
        values = {key: body_table[key] for key in BODY_KEYS[kind]}
        body = _placed("[body]", Block if kind == "block" else Pillar, **values)

    solve = _table(table, "solve") if "solve" in table else {}
    _require_keys(solve, ("tolerance",), " in [solve]")
    return Scene(
        body=body,
        material=material if material is not None else Material(),
        inclusions=tuple(_inclusion(*entry) for entry in _entries(table, "inclusion")),
        loads=tuple(
            _filled(place, Load, entry, ("center_mm", "size_mm", "traction_mpa"))
            for place, entry in _entries(table, "load")
        ),
        probes=tuple(_probe(*entry) for entry in _entries(table, "probe")),
        **solve,
    )


def _design(table: dict[str, Any], material: Material | None) -> SensorDesign:
    """The design of a unit or an array; a common material fills the rubbers that the table does not give."""
    if material is not None:
        rubber = {"young_mpa": material.young_mpa, "poisson": material.poisson}
        table = {"pillar_material": rubber, "matrix_material": rubber} | table
    return design_from_dict(table, "[design]")


def _inclusion(place: str, entry: dict[str, Any]) -> Inclusion:
    _require_keys(entry, (*PRISM_KEYS, *MATERIAL_KEYS), f" in {place}", required=(*PRISM_KEYS, *MATERIAL_KEYS))
    material = _placed(place, Material, **{key: entry[key] for key in MATERIAL_KEYS})
    inclusion: Inclusion = _placed(place, Inclusion, **{key: entry[key] for key in PRISM_KEYS}, material=material)
    return inclusion


def _probe(place: str, entry: dict[str, Any]) -> Probe:
    _require_keys(entry, ("name", "kind", "center_mm", "size_mm", "position_mm"), f" in {place}", ("name", "kind"))
    kind = entry["kind"]
    if isinstance(kind, str) and kind in PROBE_KEYS:
        place_and_kind = f"{place} of kind {kind}"
        _require_keys(entry, ("name", "kind", *PROBE_KEYS[kind]), f" in {place_and_kind}", PROBE_KEYS[kind])
    probe: Probe = _placed(place, Probe, **entry)
    return probe


def _filled(place: str, make: Callable[..., Any], entry: dict[str, Any], keys: tuple[str, ...]) -> Any:
    """What `make` makes of a table that must have exactly these keys."""
    _require_keys(entry, keys, f" in {place}", required=keys)
    return _placed(place, make, **entry)


def _placed(place: str, make: Callable[..., Any], **values: Any) -> Any:
    try:
        return make(**values)
    except (SceneError, DesignError) as error:
        raise SceneError(f"{place}: {error}") from None


def _require_keys(table: dict[str, Any], known: tuple[str, ...], where: str, required: tuple[str, ...] = ()) -> None:
    for key in table:
        if key not in known:
            raise SceneError(f"unknown key {shown(key)}{where}; known are {', '.join(known) or 'none'}.")
    for key in required:
        if key not in table:
            raise SceneError(f"the key '{key}' is missing{where}; needed are {', '.join(required)}.")


def _table(table: dict[str, Any], key: str) -> dict[str, Any]:
    if key not in table:
        raise SceneError(f"the table [{key}] is missing.")
    value = table[key]
    if not isinstance(value, dict):
        raise SceneError(f"'{key}' must be one table, written [{key}], not {shown(value)}.")
    return value


def _entries(table: dict[str, Any], key: str) -> list[tuple[str, dict[str, Any]]]:
    """The entries of an array of tables, each with its place for messages."""
    value = table.get(key, [])
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        raise SceneError(f"'{key}' must be an array of tables, each written [[{key}]], not {shown(value)}.")
    return [(f"[[{key}]] {number}", entry) for number, entry in enumerate(value, start=1)]
