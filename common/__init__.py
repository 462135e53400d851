"""What every stage stands on: errors (`errors.py`), names loaded when used (`lazy.py`), checked fields of dataclasses
(`quantity.py`), files and the cache (`storage/`), worker processes (`pool.py`) and threads (`threads.py`). It knows
nothing of sensors.
"""
