"""The sensor on the table: identified from measured pairs, few or many.

In: `Pairs`, and the response of the design with its derivatives. Out: a `Twin`: the posterior of
what manufacturing left unknown, and a `Decoupler` for this very sensor. Open `identification.py` first.
"""

from decoupler.twin.identification import Twin, identify
from decoupler.twin.twin_file import TwinFile, read_twin, write_twin
from decoupler.twin.twin_samples import simulate_twin

__all__ = ["Twin", "TwinFile", "identify", "read_twin", "simulate_twin", "write_twin"]
