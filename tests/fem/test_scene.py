"""Scenes are read as written, and nonsense is refused in one line that says what to mend."""

import math

import pytest

from common.errors import SceneError
from fem.kernel.loads import DeadLoad, FollowerLoad, StiffLoad
from fem.methods.solving import solve_scene
from fem.scene.scene import Block, Inclusion, Pillar
from fem.scene.scene_file import read_scene, scene_from_toml
from geometry.design import Material
from tests.fem.scenes import BLOCK, EXAMPLES, PILLAR


def test_a_scene_is_read_as_written():
    scene = scene_from_toml(BLOCK)
    assert scene.body == Block(size_mm=(30.0, 30.0, 10.0))
    assert scene.inclusions[0].material == Material(young_mpa=61.0, poisson=0.3)
    assert scene.probe_rectangles_mm.tolist() == [[11.0, 10.5, 19.0, 19.5]]
    assert scene.probe_points_mm.tolist() == [[15.0, 15.0, 5.0]]
    assert (scene.top_mm, scene.height_mm, scene.tolerance) == ((0.0, 0.0, 30.0, 30.0), 10.0, 2e-3)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_scenes_are_scenes(path):
    assert read_scene(path).probes


@pytest.mark.long
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_scenes_are_solved_to_their_tolerance(path):
    scene = read_scene(path)
    solution, _ = solve_scene(scene)
    assert solution.error_estimate <= scene.tolerance


def test_kinds_of_loads_and_a_model_are_read_as_written():
    """In linear scenes a pressure pushes along −z; force and moment of a plate are spread over it and its halves."""
    stiff = 'kind = "stiff"\ncenter_mm = [5, 5]\nsize_mm = [4, 4]\nforce_n = [1, 2, -3]\nmoment_nmm = [0, 4, 0]\n'
    follower = 'kind = "follower"\ncenter_mm = [25, 5]\nsize_mm = [4, 2]\npressure_mpa = 2\ntraction_mpa = [0.5, 0]\n'
    text = BLOCK.replace("poisson = 0.49", 'poisson = 0.49\nmodel = "neo-hookean"')
    scene = scene_from_toml(text + f"[[load]]\n{stiff}[[load]]\n{follower}")
    assert (scene.is_linear, scene_from_toml(BLOCK).is_linear) == (False, True)
    assert [type(load) for load in scene.loads] == [DeadLoad, StiffLoad, FollowerLoad]
    couple = [[3.0, 3.0, 5.0, 7.0], [5.0, 3.0, 7.0, 7.0]]
    assert scene.load_rectangles_mm.tolist() == [
        [10.0, 10.0, 20.0, 20.0], [3.0, 3.0, 7.0, 7.0], *couple, [23.0, 4.0, 27.0, 6.0]
    ]  # fmt: skip
    assert scene.tractions_mpa.tolist() == [
        [0.0, 0.0, -1.0], [1 / 16, 2 / 16, -3 / 16], [0.0, 0.0, 0.25], [0.0, 0.0, -0.25], [0.5, 0.0, -2.0]
    ]  # fmt: skip


SWAPS = [
    ("[body]\n", "spam = 1\n[body]\n", "unknown key 'spam'"),
    ('kind = "block"', "", "[body]: kind is missing"),
    ("size_mm = [30.0, 30.0, 10.0]", "", "the key 'size_mm' is missing in [body]"),
    ("[30.0, 30.0, 10.0]", "[30.0, 30.0]", "must be 3 finite numbers"),
    ("[30.0, 30.0, 10.0]", "[30.0, nan, 10.0]", "must be 3 finite numbers"),
    ("[30.0, 30.0, 10.0]", "[1e300, 30.0, 10.0]", "from 1e-06 to 1e+06"),
    ("[material]\nyoung_mpa = 6.1\npoisson = 0.49", "", "the table [material] is missing"),
    ("[[load]]", "[load]", "'load' must be an array of tables, each written [[load]]"),
    ("traction_mpa", "pressure_mpa", "unknown key 'pressure_mpa' in [[load]] 1; known are center_mm, size_mm"),
    ("traction_mpa = [0", "kind = 'rigid'\ntraction_mpa = [0", "[[load]] 1: kind='rigid' is unknown; it must be one"),
    ("traction_mpa = [0.0, 0.0, -1.0]", "kind = 'follower'", "the key 'pressure_mpa' is missing in [[load]] 1 of kind"),
    ("[[load]]", "[[load]]\nkind = 'stiff'\ncenter_mm = [9, 9]\nsize_mm = [4, 4]\nforce_n = [0, 0, -1]\n[[load]]",
     "loads 1 and 2 share a stiff plate's rectangle"),
    ("size_mm = [10.0, 10.0]", "size_mm = [10.0, 0.0]", "[[load]] 1: size_mm=[10.0, 0.0] must be above 0"),
    ("center_mm = [15.0, 15.0]\nsize_mm = [10", "center_mm = [25.001, 15.0]\nsize_mm = [10", "load 1 covers x 20.001"),
    ("center_mm = [15.0, 15.0]\nsize_mm = [8", "center_mm = [15.0, -15.0]\nsize_mm = [8", "probe 'patch' covers"),
    ("position_mm = [15.0, 15.0, 5.0]", "position_mm = [15.0, 15.0, 10.1]", "probe 'point' at [15, 15, 10.1] mm is in"),
    ("position_mm = [15.0, 15.0, 5.0]", "center_mm = [1.0, 1.0]", "[[probe]] 2: a probe of kind 'point' takes"),
    ('name = "point"', 'name = "patch"', "two probes have the name 'patch'"),
    ('kind = "mean"', 'kind = "median"', "kind='median' must be 'mean' or 'point'"),
    ("top_mm = [20.0, 15.0, 10.0]", "top_mm = [29.5, 15.0, 10.0]", "inclusion 1 reaches from [9, 13.5, 0] to [30.5"),
    ("top_mm = [20.0, 15.0, 10.0]", "top_mm = [20.0, 15.0, 0.0]", "top_mm=[20.0, 15.0, 0.0] must lie above base"),
    ("[[load]]", BLOCK[BLOCK.index("[[inclusion]]") : BLOCK.index("[[load]]") + 8], "inclusions 1 and 2 overlap"),
    ("tolerance = 2e-3", "tolerance = 0", "tolerance=0 must be a number above 0 and below 1"),
    ("[body]", "[body", "not valid TOML"),
    ('kind = "block"', 'kind = "array"', "unknown key 'inclusion' in a scene of kind array; known are body"),
]  # fmt: skip


@pytest.mark.parametrize(("given", "written", "says"), SWAPS, ids=range(len(SWAPS)))
def test_nonsense_is_refused_in_one_line(given, written, says):
    assert given in BLOCK
    with pytest.raises(SceneError) as refusal:
        scene_from_toml(BLOCK.replace(given, written, 1), "my.toml")
    message = str(refusal.value)
    assert message.startswith("my.toml: ")
    assert says in message
    assert "\n" not in message


def test_a_pillar_stands_on_the_base_and_a_point_beside_an_oblique_one_is_in_the_air():
    """At half height the pillar is around x = 5: there is air above its base and below its top."""
    probe = '[[probe]]\nname = "p"\nkind = "point"\nposition_mm = [{}, 0.0, 5.0]\n'
    assert scene_from_toml(PILLAR + probe.format(5.9))
    for x in (3.9, 6.1):
        with pytest.raises(SceneError, match=r"probe 'p' at .* is in the air"):
            scene_from_toml(PILLAR + probe.format(x))
    with pytest.raises(SceneError, match="must lie on the clamped base"):
        Pillar(section_mm=(1, 1), base_mm=(0, 0, 1), top_mm=(0, 0, 9))


def inclusion(x: float, to: float, z: tuple[float, float] = (0.0, 10.0)) -> Inclusion:
    """A prism of 2 × 2 mm in the middle plane, from x at its base to another x at its top."""
    return Inclusion(base_mm=(x, 15.0, z[0]), top_mm=(to, 15.0, z[1]), section_mm=(2.0, 2.0))


@pytest.mark.parametrize(
    ("one", "other", "cuts"),
    [
        (inclusion(10, 10), inclusion(11.99, 11.99), True),
        (inclusion(10, 20), inclusion(20, 10), True),  # crossed
        (inclusion(10, 20), inclusion(12, 22), False),  # parallel, touching
        (inclusion(10, 10), inclusion(10, 10, (5.0, 9.0)), True),  # one inside the other
        (inclusion(10, 10, (0.0, 5.0)), inclusion(10, 20, (5.0, 9.0)), False),  # one on the other
        (inclusion(10, 12), inclusion(14, 12), True),  # they meet at the top only
        (inclusion(10, 12), inclusion(16, 14), False),  # an edge in common at the top
    ],
)
def test_overlap_of_oblique_prisms(one, other, cuts):
    assert one.cuts(other, 1e-7) is cuts
    assert other.cuts(one, 1e-7) is cuts


def test_rounding_never_puts_a_rectangle_past_the_top():
    """0.1 + 0.2 is not 0.3: such a load is taken, and cut at the face."""
    size = math.nextafter(30.0, 31.0)
    scene = scene_from_toml(BLOCK.replace("size_mm = [10.0, 10.0]", f"size_mm = [{size!r}, 10.0]"))
    assert scene.load_rectangles_mm[0, [0, 2]].tolist() == [0.0, 30.0]
