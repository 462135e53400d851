"""Forces as they come: drawn in a terminal for people, one JSON object a line for pipes."""

import json
import time
from collections import deque

from rich.console import Console, Group
from rich.live import Live

from tripillar.board.session import Session, scans
from tripillar.board.view import live_view

SHOWN_S = 0.1  #: between two pictures
RENEWED_S = 0.1  #: between two calculations of the deviations
RATE_OVER = 64  #: scans whose pace is the rate shown
MIN_FULL_SCALE_N = 10.0  #: that is drawn brightest, so that noise at rest stays dark


def show_forces(reading: Session, seconds: float) -> None:
    """Draw the newest forces ten times a second; scans in between are read, not drawn."""
    scanner, axes = reading.scanner, reading.model.component.axes
    times: deque[float] = deque(maxlen=RATE_OVER)
    full_scale, shown = MIN_FULL_SCALE_N, 0.0
    with Live(console=Console(), auto_refresh=False) as screen:
        for scan in scans(scanner, seconds):
            if scan is not None:
                times.append(scan.received_s)
            if time.monotonic() - shown < SHOWN_S:
                continue
            shown = time.monotonic()
            notes = [scanner.trouble] if scanner.trouble else []
            latest = scanner.latest()
            if latest is None:
                screen.update(Group("waiting for scans", *notes), refresh=True)
                continue
            found = reading.forces(latest)
            if n_saturated := int(found.saturated.sum()):
                notes.append(f"{n_saturated} pillars at an end of the converter's range: forces extrapolated")
            full_scale = max(full_scale, float(abs(found.force_n).max()))
            rate_hz = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 and times[-1] > times[0] else 0.0
            deviation = reading.deviations(found)
            view = live_view(found.force_n[0], deviation, axes, full_scale, rate_hz, scanner.stats, notes)
            screen.update(view, refresh=True)


def print_lines(reading: Session, seconds: float) -> None:
    """One JSON object for every scan; one that names the trouble when scans fail to come, and when they do again.

    Deviations, which take ten times as long as forces, are `RENEWED_S` old at most. Ends quietly when the pipe's other
    end closes.
    """
    trouble, deviation, renew_s = None, "null", 0.0
    try:
        for scan in scans(reading.scanner, seconds):
            if reading.scanner.trouble != trouble:
                trouble = reading.scanner.trouble
                print(json.dumps({"trouble": trouble}), flush=True)
            if scan is None:
                continue
            found = reading.forces(scan)
            if scan.received_s >= renew_s:
                renew_s = scan.received_s + RENEWED_S
                deviation_n = reading.deviations(found)
                deviation = json.dumps(None if deviation_n is None else deviation_n.round(4).tolist())
            line = {
                "time_s": scan.time_s,
                "sequence": scan.frame.sequence,
                "axes": reading.model.component.axes,
                "force_n": found.force_n[0].round(4).tolist(),
                "saturated": int(found.saturated.sum()),
                "dropped": reading.scanner.dropped,
            }
            # put in as text, which is as long again as all the rest
            print(json.dumps(line)[:-1] + f', "deviation_n": {deviation}' + "}", flush=True)
    except BrokenPipeError:
        pass
