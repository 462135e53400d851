"""Pictures of deformed bodies, imported by nothing in `fem`.

`colours.py` (values to colours and scales), `scenery.py` (scale bar and axes), `legend.py` (colour bars),
`deformation.py` (the picture).
"""
