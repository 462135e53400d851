"""What the page looks like: controls at the left, the array in the middle, numbers at the right."""

from pathlib import Path
from typing import Any

from trame.ui.vuetify3 import VAppLayout
from trame.widgets import client, html, rca
from trame.widgets import vuetify3 as vuetify
from trame_rca.view_adapter import RcaViewAdapter

from dataset.protocols import FRICTION
from geometry.design import SensorDesign
from studies.viewer.page.loads import MOST_PRESSURE_MPA, MOST_SHEAR_MPA
from studies.viewer.page.page import CAP, Page
from studies.viewer.page.scene import TITLES

STYLE = Path(__file__).with_name("page.css")
SCALES = (1, 2, 5, 10)  #: of displacements
NOISES = {0.0: "exact", 0.001: "0.1 % noise", 0.005: "0.5 % noise", 0.01: "1 % noise"}  #: of the readings, relative


def lay_out(server: Any, page: Page, design: SensorDesign, decoupler: str) -> None:
    """Build the page in a trame server; `decoupler` names what makes forces of resistances."""
    with VAppLayout(server, theme=("dark ? 'dark' : 'light'",)) as layout:
        layout.title = "TriPillar"
        client.Style(STYLE.read_text(encoding="utf-8"))
        classes = "{page: true, dark: dark}"
        with html.Div(classes=(classes,), style=f"--cols: {design.array.cols}"):
            _head(page, design)
            with html.Div(classes="left panel"):
                _controls(page, design)
            with html.Div(classes="middle"):
                _picture(server, page)
            with html.Div(classes="right panel"):
                _numbers(decoupler)


def _head(page: Page, design: SensorDesign) -> None:
    array = design.array
    with html.Div(classes="head"):
        html.B("TriPillar")
        html.Span(f"{array.rows} × {array.cols} units, pitch {array.pitch_mm:g} mm", classes="dim")
        html.Span("{{ trouble }}", classes="trouble", v_if="trouble")
        html.Span(classes="space")
        html.Span("computed in {{ compute_ms }} ms, drawn in {{ draw_ms }} ms", classes="dim", id="times")
        vuetify.VBtn(
            icon=("dark ? 'mdi-weather-sunny' : 'mdi-weather-night'",), click="dark = !dark", variant="text",
            density="comfortable", size="small", title="pale or dark",
        )  # fmt: skip


def _controls(page: Page, design: SensorDesign) -> None:
    with vuetify.VBtnToggle(
        v_model=("source",), mandatory=True, density="compact", divided=True, variant="outlined", classes="source"
    ):
        vuetify.VBtn("Pads", value="pads", id="by-pads")
        vuetify.VBtn("Indenter", value="indenter", id="by-indenter")
        if page.feed is not None:
            vuetify.VBtn("Sensor", value="sensor", id="by-sensor")
    html.Div("{{ source == 'sensor' ? 'decoupled pressure' : 'pressure' }} on each pad [MPa]", classes="caption")
    with (
        html.Div(classes="pads", id="pads"),
        html.Button(
            v_for="cell in pads",
            key="cell.unit",
            click="pad = cell.unit",
            style=("{background: cell.colour}",),
            classes=("{chosen: cell.unit == pad}",),
            id=("'pad-' + cell.unit",),
        ),
    ):
        html.Span("{{ cell.text }}")
        html.Small("{{ cell.arrow }}")
    limit = f"cone ? {FRICTION:g} * %s : {MOST_SHEAR_MPA:g}"
    with html.Div(v_if="source == 'pads'"):
        html.Div("pad of {{ unit_name }}", classes="caption")
        _slider("pressure", "pressure", "MPa", 0, MOST_PRESSURE_MPA, 0.05)
        _slider("shear", "shear", "MPa", 0, (limit % "pressure",), 0.01)
        _slider("angle", "towards", "°", 0, 360, 5)
    with html.Div(v_if="source == 'indenter'"):
        html.Div("round indenter, a bell of pressure", classes="caption")
        half_x, half_y = design.slab_mm[0] / 2, design.slab_mm[1] / 2
        _slider("peak", "pressure", "MPa", 0, MOST_PRESSURE_MPA, 0.05)
        _slider("at_x", "x", "mm", -half_x, half_x, 0.5)
        _slider("at_y", "y", "mm", -half_y, half_y, 0.5)
        _slider("width", "width", "mm", 5, 40, 0.5)
        _slider("drag", "shear", "MPa", 0, (limit % "peak",), 0.01)
        _slider("drag_angle", "towards", "°", 0, 360, 5)
    if page.feed is not None:
        with html.Div(v_if="source == 'sensor'", classes="sensor"):
            html.Div(page.feed.port, classes="port")
            html.Div("{{ link }}", id="link")
            vuetify.VBtn(
                "Play again", v_if="ended", click=page.play_again, size="small", variant="tonal", id="play-again"
            )
    with html.Div(v_if="source != 'sensor'", classes="row"):
        vuetify.VSwitch(
            v_model=("cone",), label=f"shear ≤ {FRICTION:g} × pressure", density="compact", hide_details=True,
            color="primary",
        )  # fmt: skip
        vuetify.VBtn("Reset", click=page.reset, size="small", variant="tonal", id="reset")
    html.Hr()
    with html.Div(classes="row"):
        colours = [{"title": title.split(" [")[0], "value": name} for name, title in TITLES.items()]
        _choice("colour", "pillars' colour", colours)
    with html.Div(classes="row"):
        scales = [{"title": f"{scale} ×", "value": scale} for scale in SCALES]
        _choice("scale", "displacement", scales)
        noises = [{"title": title, "value": noise} for noise, title in NOISES.items()]
        _choice("noise", "readings", noises, v_if="source != 'sensor'")


def _slider(name: str, label: str, unit: str, least: float, most: Any, step: float) -> None:
    with html.Div(classes="slider", id=name):
        html.Label(label)
        vuetify.VSlider(
            v_model=(name,), min=least, max=most, step=step, hide_details=True, density="compact", color="primary",
            thumb_size=14, track_size=3,
        )  # fmt: skip
        html.Output(f"{{{{ +{name}.toFixed(2) }}}} {unit}")  # steps of 0.01 add up to 0.09999999999999999


def _choice(name: str, label: str, items: list[dict[str, Any]], **attributes: Any) -> None:
    vuetify.VSelect(
        v_model=(name,), label=label, items=(f"{name}_choices", items), density="compact", hide_details=True,
        variant="outlined", **attributes,
    )  # fmt: skip


def _picture(server: Any, page: Page) -> None:
    area = rca.RemoteControlledArea(name="array", display="image", image_style=({"width": "100%", "height": "100%"},))
    adapter = RcaViewAdapter(
        page.pictures, "array", scheduler=page.pictures, do_schedule_render_on_interaction=False
    )  # pictures know better which events change them
    area.add_view_handler(adapter)
    with html.Div(classes="legend", id="legend"):
        html.Span("{{ legend.low }}")
        html.Div(classes="bar", style=("{background: legend.colours}",))
        html.Span("{{ legend.high }}")
        html.Span("{{ legend.title }}", classes="dim")
    vuetify.VBtn(
        icon="mdi-home-outline", click=page.look_from_the_start, variant="text", size="small", classes="home",
        title="look from the start again; drag to turn, scroll to come nearer, shift-drag to move",
    )  # fmt: skip


def _numbers(decoupler: str) -> None:
    with html.Div(classes="strain", id="strain"):
        html.Div(
            "largest strain <b>{{ strain }} %</b> <span class='dim'>of "
            + f"{100 * CAP:g} %, "
            + "{{ strain_at }}</span>"
        )
        with html.Div(classes="gauge"):
            html.Div(style=("{width: strain_share + '%'}",), classes=("{over: strain_over}",))
    with vuetify.VTabs(v_model=("tab",), density="compact", color="primary", height=32):
        vuetify.VTab("Maps", value="maps")
        vuetify.VTab("Table", value="table", id="to-table")
    with html.Div(v_if="tab == 'maps'", classes="scroll"):
        html.Div("resistance, change from rest", classes="caption")
        _maps("resistance_maps")
        html.Div(f"decoupled forces, by {decoupler}", classes="caption", id="decoupler")
        _maps("force_maps")
        with html.Div(classes="caption"):
            html.Span("unit of {{ unit_name }}")
            html.Span("{{ rms ? 'all forces missed by ' + rms + ' N (rms)' : '' }}", id="rms")
        with html.Div(classes="tables"):
            _table(["pillar", "R [kΩ]", "change [%]", "strain [%]"], "unit_pillars", "unit-pillars")
            _table(["[N]", "applied", "decoupled", "error"], "unit_forces", "unit-forces")
    with html.Div(v_if="tab == 'table'", classes="scroll whole"):
        head = ["unit", "Rz", "Rx", "Ry", *(f"F{axis} {kind}" for axis in "xyz" for kind in ("appl.", "dec."))]
        html.Div("resistances [kΩ]; applied and decoupled forces [N]; units by row, col", classes="caption")
        _table(head, "rows", "whole-table")


def _maps(name: str) -> None:
    with html.Div(classes="maps"), html.Div(v_for=f"map in {name}", key="map.title", classes="map"):
        with html.Div(classes="caption"):
            html.B("{{ map.title }}")
            html.Span("± {{ map.most }} {{ map.unit }}")
        with html.Div(classes="cells"):
            html.Div(
                "<span>{{ cell.text }}</span>",
                v_for="cell in map.cells",
                key="cell.unit",
                click="pad = cell.unit",
                style=("{background: cell.colour}",),
                classes=("{chosen: cell.unit == pad}",),
                title=("cell.text + ' ' + map.unit",),
            )


def _table(head: list[str], rows: str, name: str) -> None:
    with html.Table(id=name):
        with html.Thead(), html.Tr():
            for word in head:
                html.Th(word)
        with html.Tbody(), html.Tr(v_for=f"row in {rows}", key="row[0]"):
            html.Td("{{ value }}", v_for="(value, place) in row", key="place")
