"""What a layout is worth, as two small tables, on coarse cells."""

import json
from functools import partial

from dataset.indentation import drawn_press
from fem.array.closed_forms import layer_response
from studies.layouts import layouts


def test_a_layout_is_judged_by_pads_behind_a_converter_and_by_touch_through_plates(monkeypatch, tmp_path):
    monkeypatch.setattr("studies.layouts.array_response", lambda design: (layer_response(design), None, True))
    monkeypatch.setattr("fem.contact.surface._extrapolated", lambda source: source.condensed(1, 3))
    monkeypatch.setattr("studies.touched.CELLS", 16)
    monkeypatch.setattr("dataset.indentation.drawn_press", partial(drawn_press, cells=16))
    layouts(["six-pillar"], units=2, samples=300, contacts=2, out=tmp_path)
    back, touch = json.loads((tmp_path / "layouts.json").read_text())["tables"].values()
    assert [row["pads"] for row in back] == ["soft", "stiff"]
    assert all(max(row["times the limit"]) < 1.3 for row in back)  # of 300 samples; 1.1 of 5000
    for row, shapes in zip(touch, ("known", "unknown"), strict=True):
        assert row["shapes"] == shapes
        assert max(row["fx / fy / fz [N]"]) < 2.0
