"""The array's response turned around.

`forward_model` gives resistances for forces, `model_inverse` forces for resistances, `limits` the least error that
noise leaves.
"""
