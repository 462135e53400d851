"""The drawings of the documentation that need no solver: ``python -m studies.pictures.drawings docs``."""

from pathlib import Path

from geometry.design import SensorDesign
from tripillar.terminal.entry import run_alone


def draw(folder: Path) -> None:
    """Draw the unit with its wiring, and one load of each protocol."""
    from dataset.protocol_pictures import draw_protocols
    from geometry.drawing import draw_build

    draw_build(SensorDesign(), folder / "build.png")
    draw_protocols(SensorDesign(), folder / "protocols.png")


if __name__ == "__main__":
    run_alone(draw)
