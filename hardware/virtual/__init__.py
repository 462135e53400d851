"""The sensor in a simulation of others, in torch: contacts in, what the sensor reads and its forces out.

Open `sensor.py`: `VirtualSensor` does all of it for many environments at once. `wires.py` is the crossbar and
`decoding.py` the decoder, each the torch twin of what reads a board.
"""

from hardware.virtual.sensor import Reading, VirtualSensor

__all__ = ["Reading", "VirtualSensor"]
