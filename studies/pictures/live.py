"""The display of `tripillar live` as a picture for the README: `python -m studies draw-live docs/live.svg`."""

import io
from pathlib import Path

from rich.console import Console

from common.storage.files import write_text
from geometry.design import SensorDesign
from hardware.boards.simulated import PressAndSlide, press_and_slide
from hardware.link.frames import ScanMode
from hardware.link.reception import LinkStatistics
from hardware.readout.calibration import Electronics
from hardware.readout.forces import ForceReader
from studies.paper_sensor import board_info, joint_net
from tripillar.pipeline.stage import respond
from tripillar.terminal.force_view import live_view
from tripillar.terminal.progress import Bars

MODE = ScanMode.ZERO_POTENTIAL
SHARE = 0.55  #: of the script's period: the indenter slides


def draw(out: Path) -> None:
    """Draw one scan of the simulated sensor, read by a zero-potential board."""
    with Bars(quiet=False) as bars:
        _, response = respond(SensorDesign(), bars)
    motion, model, info = press_and_slide(response, PressAndSlide()), joint_net(response), board_info(MODE)
    counts = Electronics().crossbar(info).counts(motion.resistance_ohm)
    k = round(SHARE * len(counts))
    found = ForceReader(info, model).forces(counts[k : k + 1])[0]
    assert found.deviation_n is not None, "the joint net knows its uncertainty"
    view = live_view(found, model.component.axes, float(found.force_n.max()), info.rate_hz, LinkStatistics(ok=k), [])
    console = Console(record=True, width=92, force_terminal=True, color_system="truecolor", file=io.StringIO())
    console.print(view)
    write_text(console.export_svg(title="tripillar live"), out)
