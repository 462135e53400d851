"""The paper's decoupling experiments on our own data: table 2 and figures 9, 10 and 11.

In: an array's response. Out: every number beside the paper's, as JSON, tables, pictures and a report. Open
`experiments.py` for what is trained and tested, `printed.py` for what the paper prints, `report.py` for what is said
of both.
"""
