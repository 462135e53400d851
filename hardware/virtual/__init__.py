"""The sensor in a simulation of others, in torch: contacts in, what the sensor reads and its forces out.

Open `sensor.py`: `VirtualSensor` does all of it for many environments at once. The decoder is that which reads a board, with
tensors for arrays (`decoupler.model.in_torch`); the crossbar is that of `readout`.
"""

from hardware.virtual.sensor import Reading, VirtualSensor

__all__ = ["Reading", "VirtualSensor"]
