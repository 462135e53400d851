"""Pictures of deformed bodies, imported by nothing in `fem`.

`colours.py` (values to colours and scales), `scenery.py` (scale bar, axes and colour bars), `deformation.py` (the
picture).
"""
