"""What drives the stages from above.

In: a design. Out: files of every stage and a table of decoupling errors beside the paper's. Open `pipeline.py` first,
then `comparison.py` (what is compared) and `report.py` (how it is shown).
"""
