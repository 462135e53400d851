"""The sensor in robot simulators: contacts of MuJoCo become forces on the array, and observations in Gymnasium.

In: a MuJoCo model with a slab, and a `hardware.virtual.VirtualSensor`. `contacts.py` has the forces on the slab in the
sensor's frame, `observations.py` Gymnasium wrappers. Each loads its simulator, of the extra `simulators`; this file
does not. `examples/` has a finger on a slab, its press and an environment to begin with.
"""
