"""Pictures of deformed bodies, imported by nothing in `fem`.

In the order of the data: `arrays.py` (displacement and stress anywhere in an array, and loads to show), `parts.py` (a
loaded sensor or scene in parts to draw), `deformation.py` (their picture, with colour bars, scale bar and axes),
`contact.py` (a contact from above).
"""
