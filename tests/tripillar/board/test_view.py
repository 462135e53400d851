"""The terminal view: units as they lie, shear as arrows, colours by force."""

import numpy as np
from rich.console import Console

from hardware.link.scanner import ScannerStatistics
from tripillar.board.view import force_table, live_view


def drawn(renderable):
    console = Console(width=120, color_system=None, record=True)
    with console.capture() as capture:
        console.print(renderable)
    return capture.get()


def test_rows_go_up_and_columns_to_the_right():
    """Row 0 has the least y: it is drawn last."""
    force_n = np.arange(6.0).reshape(2, 3, 1)
    lines = drawn(force_table(force_n, ("z",), 10.0)).splitlines()
    assert [line.split() for line in lines] == [["3.0", "4.0", "5.0"], ["0.0", "1.0", "2.0"]]


def test_arrows_point_along_the_shear():
    for (fx, fy), arrow in {(1, 0): "→", (0, 1): "↑", (-1, 0): "←", (0, -1): "↓", (1, 1): "↗", (-1, -1): "↙"}.items():
        assert arrow in drawn(force_table(np.array([[[fx, fy, 5.0]]]), ("x", "y", "z"), 10.0))
    assert not set("→↗↑↖←↙↓↘") & set(drawn(force_table(np.array([[[0.1, 0.0, 5.0]]]), ("x", "y", "z"), 10.0)))


def test_a_model_of_shear_alone_shows_its_size():
    assert "3.0 ←" in drawn(force_table(np.array([[[-3.0]]]), ("x",), 10.0))


def test_the_view_says_what_is_wrong():
    force_n = np.ones((1, 2, 3))
    text = drawn(
        live_view(
            force_n, force_n, ("x", "y", "z"), 10.0, 150.0, ScannerStatistics(ok=7, lost=2), ["no frames for 2 s"]
        )
    )
    for said in ("150.0 frames/s", "7 ok", "2 lost", "no frames for 2 s", "ΣFz      2.0 N", "± 1.0 N"):
        assert said in text
