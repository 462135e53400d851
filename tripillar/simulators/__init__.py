"""The sensor in robot simulators: contacts of MuJoCo become forces on the array, and observations in Gymnasium.

In: a MuJoCo model with a slab, and a `hardware.virtual.VirtualSensor`. `contacts.py` has the forces on the slab in the
sensor's frame, `press_model.py` a finger on a slab, to begin with. `observations.py` has Gymnasium wrappers, `press.py`
an environment that they wrap. Each loads its simulator, of the extra `simulators`; this file does not.
"""
