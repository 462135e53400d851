"""The drawings of the documentation that need no solver: ``python -m studies.pictures docs``."""

from pathlib import Path

from geometry.design import SensorDesign
from studies.entry import run_alone


def draw(folder: Path) -> None:
    """Draw the unit with its wiring, and one load of each protocol."""
    from dataset.figures import draw_protocols
    from geometry.figures import draw_build

    draw_build(SensorDesign(), folder / "build.png")
    draw_protocols(SensorDesign(), folder / "protocols.png")


if __name__ == "__main__":
    run_alone(draw)
