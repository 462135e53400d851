"""What a recording states once: the board, the calibration in use and what the recorder worked with."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from geometry.errors import FileFormatError
from hardware.link.frames import FrameError, Info, ScanMode

FORMAT, VERSION = "tripillar recording", 2
MADE_FROM = ("model_recipe", "design_hash")  #: what may be said of a recording's origin


@dataclass(frozen=True, kw_only=True)
class Header:
    """Written first, the same to every kind of file; two recordings with one header may be one."""

    info: Info
    calibration: str = ""  #: JSON text
    made_from: Mapping[str, str] = field(default_factory=dict)  #: some of `MADE_FROM`

    def __post_init__(self) -> None:
        foreign = set(self.made_from) - set(MADE_FROM)
        if foreign:
            raise ValueError(f"made_from has {sorted(foreign)}, allowed are {list(MADE_FROM)}: leave out the rest.")

    def plain(self) -> dict[str, int | str]:
        """As numbers and text: what is empty is there, too.

        >>> plain = Header(info=Info(firmware=(1, 2, 3)), made_from={"design_hash": "a1"}).plain()
        >>> plain["scan_mode"], plain["firmware"], plain["design_hash"], plain["model_recipe"]
        ('DIVIDER', '1.2.3', 'a1', '')
        """
        info: dict[str, int | str] = asdict(self.info)
        info |= {"scan_mode": self.info.scan_mode.name, "firmware": ".".join(map(str, self.info.firmware))}
        made_from = {name: self.made_from.get(name, "") for name in MADE_FROM}
        return {"format": FORMAT, "version": VERSION, **info, "calibration": self.calibration, **made_from}


def read_header(plain: Mapping[str, Any], source: str) -> Header:
    """The header that `Header.plain` gave, whatever else `plain` holds; anything else is a FileFormatError."""
    if plain.get("format") != FORMAT:
        raise FileFormatError(f"{source}: not a recording of TriPillar: give a file made by a recorder.")
    try:
        if int(plain["version"]) > VERSION:
            raise FileFormatError(
                f"{source}: a recording of version {plain['version']}, this program reads up to {VERSION}: update it."
            )
        values = {each.name: plain[each.name] for each in fields(Info)}
        values |= {name: int(value) for name, value in values.items() if name not in ("scan_mode", "firmware")}
        values["scan_mode"] = ScanMode[values["scan_mode"]]
        values["firmware"] = tuple(int(part) for part in values["firmware"].split("."))
        made_from = {name: str(plain[name]) for name in MADE_FROM if plain.get(name)}
        return Header(info=Info(**values), calibration=str(plain["calibration"]), made_from=made_from)
    except (KeyError, TypeError, AttributeError, ValueError, FrameError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(
            f"{source}: its header is damaged ({type(error).__name__}: {error}): give a file made by a recorder."
        ) from None
