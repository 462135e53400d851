"""What the firmware has to know of a sensor: its wires and channels, as a header in C."""

import json

from geometry.layout import Layout
from geometry.layout_file import layout_tables
from geometry.wiring import unit_crossings
from hardware.link.frames import stated

CONVERSION_US, MARGIN_US = 52, 50  #: of the firmware (settings.h): time of a conversion, of a scan beside them


def fastest_hz(n_crossings: int) -> int:
    """Scans a second that the firmware has time for [Hz].

    >>> fastest_hz(108), fastest_hz(216)
    (176, 88)
    """
    return 1_000_000 // (CONVERSION_US * n_crossings + MARGIN_US)


def sensor_header(rows: int, cols: int, layout: Layout) -> str:
    """The text of a header for ``make -C hardware/firmware SENSOR=FILE``: an array of rows × cols units of a layout.

    >>> from geometry.layout import LAYOUTS
    >>> print(*sensor_header(2, 3, LAYOUTS["upright-four"]).splitlines()[-5:], sep=chr(10))
    #define UNIT_ROWS 4  // row wires of a unit
    #define UNIT_COLUMNS 4  // column wires of a unit
    #define UNIT_PILLARS 4
    #define UNIT_CROSSINGS {0x1, 0x4, 0x8, 0x2}  // of each row wire: bit k is set where a pillar joins column wire k
    #define LAYOUT "upright-four"  // as INFO states it
    """
    populated = unit_crossings(layout) >= 0
    masks = ", ".join(f"{sum(1 << k for k, is_there in enumerate(row) if is_there):#x}" for row in populated.tolist())
    name = layout_tables(layout).get("layout", f"{len(layout.pillars)} pillars each")
    lines = [
        f"// {rows} x {cols} units of {name}; 'tripillar export --to header' wrote it.",
        *("#ifndef ROWS", f"#define ROWS {rows}  // units along y", "#endif"),
        *("#ifndef COLS", f"#define COLS {cols}  // units along x", "#endif"),
        f"#define UNIT_ROWS {populated.shape[0]}  // row wires of a unit",
        f"#define UNIT_COLUMNS {populated.shape[1]}  // column wires of a unit",
        f"#define UNIT_PILLARS {len(layout.pillars)}",
        f"#define UNIT_CROSSINGS {{{masks}}}  // of each row wire: bit k is set where a pillar joins column wire k",
        f"#define LAYOUT {json.dumps(stated(layout))}  // as INFO states it",
    ]
    return "\n".join([*lines, ""])
