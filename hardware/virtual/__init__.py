"""The sensor in a simulation of others, in torch: contacts in, what the sensor reads and its forces out.

Open `sensor.py`: `VirtualSensor` does all of it for many environments at once. It decodes with the code that reads a
board, on tensors (`decoupler.model.tensors`); the crossbar is that of `readout`.
"""

from hardware.virtual.sensor import Reading, VirtualSensor

__all__ = ["Reading", "VirtualSensor"]
