"""A trained model: ohms in, newtons and their half-widths out.

`settings` say what is asked for, `baseline` holds the simplest decouplers, `uncertainty` how far forces can be trusted,
`decoupler` the model itself, `model_file` its file.
"""
